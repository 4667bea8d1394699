"""Web pages for operator, driver and technician, served by a process of their own (docs/technician.md)."""
