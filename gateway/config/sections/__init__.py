"""The sections of the configuration, one module a subject: keys, ranges and what each means. Pure."""
