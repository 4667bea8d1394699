"""Who may call which page, and how callers prove it (docs/hmi-security.md)."""
