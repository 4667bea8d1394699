"""The web process: the application, its routes, what moves on the pages."""
