"""The register table as files for PLC and SCADA tools: one module a format, named in registry.py."""
