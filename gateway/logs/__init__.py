"""The log's lines: their form, and how often one may be written."""
