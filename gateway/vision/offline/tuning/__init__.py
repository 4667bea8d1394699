"""Thresholds and exposure from examples: what the marker and what the background look like to the paper's method."""
