"""Following the marker from frame to frame. Pure but for the track that is kept."""
