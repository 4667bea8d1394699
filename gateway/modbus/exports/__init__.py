"""The register table in the words of PLC and SCADA tools: one module a format, all of them in formats.py."""
