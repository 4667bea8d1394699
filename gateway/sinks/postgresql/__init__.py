"""PostgreSQL. Pure: settings, tables, documents. IO: server (reads files), database, driver, sink."""
