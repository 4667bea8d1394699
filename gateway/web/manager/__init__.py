"""What a bay did, in figures for the plant's manager: the web process's side, which only reads files."""
