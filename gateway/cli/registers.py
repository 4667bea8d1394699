"""Print the Modbus register table.

gateway registers               for reading in a terminal
gateway registers --json        an array of {name, address, words, type, scale, unit, meaning[, codes or bits]}
gateway registers --markdown    as in docs/registers.md
"""

import argparse
import sys

NAME = "registers"
HELP = "print the Modbus register table as text, Markdown, CSV or JSON"


def configure(parser: argparse.ArgumentParser) -> None:
    """Adds this verb's arguments."""
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--markdown", action="store_true", help="Markdown tables, as in docs/registers.md")
    form.add_argument("--csv", action="store_true", help="one line per register, with a header")
    form.add_argument("--json", action="store_true", help="an array with one object per register")


def main(args: argparse.Namespace) -> int:
    """Prints to stdout."""
    from gateway.modbus import export

    if args.json:
        made = export.json_text()
    elif args.csv:
        made = export.csv_text()
    elif args.markdown:
        made = export.markdown()
    else:
        made = export.plain_text()
    sys.stdout.write(made)
    return 0
