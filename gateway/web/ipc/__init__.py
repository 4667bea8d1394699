"""What the main process and the web process say to each other: messages. Pure."""
