"""The messages between the main process and the web process. Pure."""
