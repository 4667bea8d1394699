"""The one table of values that outputs show of a bay and of a visit: each output picks rows and formats them."""
