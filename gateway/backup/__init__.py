"""A gateway's configuration, keys and state in one file, and back onto a machine."""
