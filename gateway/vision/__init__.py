"""Frames in, detections out; docs/architecture.md has what each folder does."""
