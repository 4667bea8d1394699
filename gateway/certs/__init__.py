"""Certificates for Modbus/TCP Security: the role extension, and a small authority for a plant that has none."""
