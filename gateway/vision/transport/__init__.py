"""How frames and messages pass between the processes."""
