"""What was recorded, for the pages and programs: the web process's side, which only reads files."""
