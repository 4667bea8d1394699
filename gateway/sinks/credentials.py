"""Passwords and certificates of the connections to other systems. IO: reads small files.

A secret may be in a file or in an environment variable. No error here quotes one. `section`: where the keys are, as
`mqtt`, for the errors.
"""

import os
import ssl
import stat

from gateway.config.sections.common import ClientTls
from gateway.sinks.contract import SettingError

MAX_BYTES = 65_535  # of a password; that of any string in MQTT
MAX_FILE_BYTES = MAX_BYTES + 2


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


def client_context(section: str, tls: ClientTls | None) -> ssl.SSLContext:
    """TLS that verifies the server's certificate and its name. Raises SettingError for a file that can't be used."""
    if tls is None:
        return ssl.create_default_context()
    try:
        context = ssl.create_default_context(cafile=tls.ca_file)
    except (OSError, ssl.SSLError) as error:
        raise SettingError(f"{section}.ca_file", _reason(error), tls.ca_file) from error
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if tls.cert_file is not None:
        secret = (
            None if tls.key_password_file is None else one_line(f"{section}.key_password_file", tls.key_password_file)
        )
        try:
            # Without a configured password OpenSSL would read one from the terminal, and the gateway would hang there.
            context.load_cert_chain(tls.cert_file, tls.key_file, password=secret or "")
        except (OSError, ssl.SSLError) as error:
            fault = f"with key_file {tls.key_file}: {_reason(error)}"
            raise SettingError(f"{section}.cert_file", fault, tls.cert_file) from error
    return context


def one_line(key: str, name: str) -> str:
    """The file's text less one newline at its end. Raises SettingError."""
    try:
        fd = os.open(name, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(fd, "rb") as file:
            if not stat.S_ISREG(os.fstat(fd).st_mode):  # read more than once, and a pipe would be waited for
                raise SettingError(key, "must be a plain file", name)
            data = file.read(MAX_FILE_BYTES + 1)
        text = data.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        raise SettingError(key, error.strerror or str(error), name) from error
    except UnicodeDecodeError:
        raise SettingError(key, "not UTF-8 text", name) from None
    if not text or len(text.encode()) > MAX_BYTES or "\n" in text:
        raise SettingError(key, f"must hold one line of 1 to {MAX_BYTES} bytes", name)
    return text


def _reason(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        reason = (error.reason or "not a certificate, or the key does not belong to it").lower().replace("_", " ")
        return f"not usable: {reason}"
    return error.strerror or str(error)
