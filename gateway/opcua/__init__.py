"""The OPC UA server, in a process of its own, from the one table of values (docs/opcua.md). Only `hardened` and the
modules that make nodes import its library."""
