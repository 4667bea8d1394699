"""Trains what the gateway ships as weights. Not a part of the package; docs: README.md."""
