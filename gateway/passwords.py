"""Passwords for other systems, in a file or in an environment variable. IO: reads small files. No error quotes one.

`section`: where the keys are, as `mqtt`, for the errors.
"""

import os
import stat

from gateway.errors import SettingError

MAX_BYTES = 65_535  # of a password; that of any string in MQTT
MAX_FILE_BYTES = MAX_BYTES + 2
ESCAPED = "write / ? # in a password as %2F %3F %23"  # in a URL


def password(section: str, file: str | None, variable: str | None, prefix: str = "") -> str | None:
    """What `password_file` or `password_env` holds; None: neither is set. `prefix`: what these keys begin with.

    Raises SettingError.
    """
    if file is not None:
        return one_line(f"{section}.{prefix}password_file", file)
    if variable is not None:
        secret = os.environ.get(variable)
        if not secret:
            raise SettingError(f"{section}.{prefix}password_env", "no such variable in the environment", variable)
        return secret
    return None


def one_line(key: str, name: str, *, read_only: bool = False) -> str:
    """The file's text less one newline at its end. `read_only`: nobody may have a permission to write it. Raises
    SettingError."""
    try:
        fd = os.open(name, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(fd, "rb") as file:
            mode = os.fstat(fd).st_mode  # of what is read: the name may be another file's by then
            if not stat.S_ISREG(mode):  # read more than once, and a pipe would be waited for
                raise SettingError(key, "must be a plain file", name)
            if read_only and mode & 0o222:
                raise SettingError(key, "must be read-only for everybody: chmod a-w", name)
            data = file.read(MAX_FILE_BYTES + 1)
        text = data.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        raise SettingError(key, error.strerror or str(error), name) from error
    except UnicodeDecodeError:
        raise SettingError(key, "not UTF-8 text", name) from None
    if not text or len(text.encode()) > MAX_BYTES or "\n" in text:
        raise SettingError(key, f"must hold one line of 1 to {MAX_BYTES} bytes", name)
    return text
