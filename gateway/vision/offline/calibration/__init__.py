"""From pictures of a board with known points to the camera's intrinsics, and how far they can be trusted."""
