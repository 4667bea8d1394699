"""The main process's side of the pages: listener, requests of the web process, its life."""
