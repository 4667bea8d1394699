"""The generated tables and diagrams of the PLC engineer's pages, computed by the gateway's own code. Pure."""
