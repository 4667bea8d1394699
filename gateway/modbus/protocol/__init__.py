"""The Modbus application protocol, sans-IO: bytes in, complete frames and answers out. Pure."""
