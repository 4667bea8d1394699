"""Sources of frames: cameras, streams, files; and what every frame must pass."""
