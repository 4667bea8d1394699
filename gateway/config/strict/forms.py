"""The forms of text that keys take: for the checker a pattern, for people words."""

NAME = r"^[A-Za-z0-9_-]{1,64}$"
USER_NAME = r"^[A-Za-z0-9._-]{1,64}$"
SYSTEM_USER = r"^[A-Za-z_][A-Za-z0-9_.-]{0,31}$"
VARIABLE = r"^[A-Za-z_][A-Za-z0-9_]*$"
BASE_PATH = r"^(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*$"
LANGUAGE = r"^[a-z]{2,3}$"
COLOUR = r"^#[0-9a-fA-F]{6}$"
BROKER_URL = r"^(mqtts?|wss?)://"
PROXY_URL = r"^http://"
POSTGRESQL_URL = r"^postgres(ql)?://"
SQL_NAME = r"^[a-z_][a-z0-9_]{0,62}$"
TOPIC_ROOT = r"^[^#+/\s][^#+\s]*$"
TOPIC_LEVEL = r"^[^#+/$\s\x00-\x1f][^#+/\x00-\x1f]{0,63}$"
TOPIC_PREFIX = r"^[^#+/\s]+$"
SPARKPLUG_ID = r"^[^#+/\x00-\x1f]{1,128}$"

WORDS = {
    NAME: "letters from A to Z, digits, _ and -, at most sixty-four",
    USER_NAME: "letters from A to Z, digits, dots, _ and -, at most sixty-four",
    SYSTEM_USER: "a user of the system: letters from A to Z, digits, dots, _ and -",
    VARIABLE: "the name of an environment variable: letters from A to Z, digits and _",
    BASE_PATH: "a path such as /bay1: letters from A to Z, digits, dots, _ and -",
    LANGUAGE: "two or three small letters, as in de",
    COLOUR: "# and six hex digits, two each of red, green and blue",
    BROKER_URL: "an address that begins with mqtt://, mqtts://, ws:// or wss://",
    PROXY_URL: "an address that begins with http://",
    POSTGRESQL_URL: "an address that begins with postgresql://",
    SQL_NAME: "small letters, digits and _, not a digit first",
    TOPIC_ROOT: "topic levels without spaces, # and +",
    TOPIC_LEVEL: "one topic level, at most sixty-four characters: without #, + and /, not $ or a space first",
    TOPIC_PREFIX: "one topic level without spaces, # and +",
    SPARKPLUG_ID: "one topic level, without #, + and /",
}
"""Pattern -> what is allowed. No numerals: the settings page looks a text up with its numbers taken out."""
