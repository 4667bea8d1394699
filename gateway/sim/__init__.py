"""A loading bay that does not exist: it renders real frames and speaks real bytes."""
