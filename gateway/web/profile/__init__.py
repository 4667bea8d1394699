"""`[vision]` as text and as parameters, for both processes: the tuning page shows it, the main process writes it."""
