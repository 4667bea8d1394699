"""Distance over a serial line. Pure: protocol, session, filters. IO: service."""
