"""Strict TOML for people: typed sections, and errors that name file, line, key, value and allowed range."""
