"""A loading bay that does not exist: it renders real frames and sends real bytes."""
