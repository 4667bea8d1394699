"""The recorder: what entered each decision, written by a process of its own, and what reads it again."""
