"""The vision processes: which there are, what they do, and who watches them."""
