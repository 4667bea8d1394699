"""The Modbus application protocol, sans-IO: bytes in, whole frames and answers out. Pure."""
