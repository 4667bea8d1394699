"""Modbus TCP. Pure: registers (the table). IO: server."""
