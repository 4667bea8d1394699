"""Make a user of the pages: reads a password and prints the table for the configuration.

Only a hash of the password (argon2id) is printed; the password itself is kept nowhere. Append what is printed to the
configuration file, run `gateway check` on it, and reload the gateway (`systemctl reload`); every login then ends.

  gateway password anna                            a viewer: sees everything, acknowledges alarms
  gateway password anna --role technician          also tunes, applies and saves settings
  gateway password anna >> /etc/gateway.toml       the questions are not printed into the file
  pass show plant/anna | gateway password anna --stdin   one line, from a password store

A forgotten password is replaced: run it again and put the new password_hash in the place of the old one. A password
needs 10 characters; three or four words that have nothing to do with each other are easy to keep and hard to guess.
"""

import argparse
import getpass
import sys
import warnings

from gateway.config.sections.hmi import USER_NAME
from gateway.errors import ConfigError
from gateway.web.auth.passwords import hashed, weakness

MAX_LINE = 4096


def configure(parser: argparse.ArgumentParser) -> None:
    """Adds this verb's arguments."""
    parser.add_argument("name", metavar="NAME", help="as typed at login: letters, digits, '.', '_', '-'")
    parser.add_argument("--role", choices=("viewer", "technician"), default="viewer", help="default: viewer")
    parser.add_argument("--stdin", action="store_true", help="read the password from standard input, one line")


def main(args: argparse.Namespace) -> int:
    """Prints TOML on stdout, questions on the terminal or stderr. Raises ConfigError for a name or password."""

    if not USER_NAME.fullmatch(args.name):
        raise ConfigError(f"gateway password: {args.name!r}: 1 to 64 letters (A to Z), digits, '.', '_' or '-'")
    password = _from_stdin() if args.stdin else _asked()
    if (why := weakness(password, args.name)) is not None:
        raise ConfigError(f"gateway password: this password {why}")
    print("\n[[hmi.users]]")
    print(f'name = "{args.name}"')
    print(f'role = "{args.role}"')
    print(f'password_hash = "{hashed(password)}"')
    return 0


def _from_stdin() -> str:
    """One line; a second one is a mistake, such as the wrong file."""
    try:
        text = sys.stdin.buffer.read(MAX_LINE).decode()
    except UnicodeDecodeError:
        raise ConfigError("gateway password: --stdin: not UTF-8 text") from None
    password = text.removesuffix("\n").removesuffix("\r")
    if not password or "\n" in password or len(text) >= MAX_LINE:
        raise ConfigError("gateway password: --stdin: should be one line with the password")
    return password


def _asked() -> str:
    """Twice, without showing it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", getpass.GetPassWarning)  # it would show what is typed
            first = getpass.getpass("Password: ")
            second = getpass.getpass("The same again: ")
    except (EOFError, getpass.GetPassWarning):
        raise ConfigError("gateway password: no terminal; --stdin reads the password from a pipe") from None
    if first != second:
        raise ConfigError("gateway password: these were two different passwords; nothing was made")
    return first
