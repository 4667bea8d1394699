"""Web pages for operator, driver and technician, served by a process of their own (docs/hmi.md)."""
