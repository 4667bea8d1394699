"""Frames of a bay with exact truth in many conditions, to compare detection methods on (`gateway benchmark`)."""
