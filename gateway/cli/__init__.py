"""The command line: verbs, argv, printing and exit codes live in this package only."""

from gateway.cli.main import main

__all__ = ["main"]
