"""Examines a plant from the gateway's place: what the configuration names is opened, measured and reported."""
