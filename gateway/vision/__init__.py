"""Frames in, detections out. Pure: pixels, stages, pipeline, intrinsics, dispatch. IO: capture, pool, service."""
