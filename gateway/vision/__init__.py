"""Frames in, detections out, in a process of its own for each bay."""
