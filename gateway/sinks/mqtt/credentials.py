"""Who we are at the broker, and whom we trust there: user, password, certificates. IO: reads small files.

Secrets may stand in the URL, in a file, or in an environment variable. Nothing here quotes one, and the record that
holds the password does not show it.
"""

import os
import ssl
import stat
from dataclasses import replace

from gateway.config import MqttConfig
from gateway.errors import ConfigError
from gateway.sinks.mqtt import address
from gateway.sinks.mqtt.address import MAX_BYTES, Broker

MAX_FILE_BYTES = MAX_BYTES + 2


class CredentialsError(ConfigError):
    """`place` is the key, as a path into the configuration; `said` what is wrong with it."""

    def __init__(self, key: str, said: str, value: str | None = None) -> None:
        super().__init__(f"{key}: {said}" if value is None else f'{key} = "{value}": {said}')
        self.place = tuple(key.split("."))
        self.said = said


def broker_of(config: MqttConfig) -> Broker:
    """The address with user and password. Raises CredentialsError naming the key, never the secret."""
    broker = address.parse(config.url)
    if config.username is not None:
        if broker.username is not None:
            raise CredentialsError("mqtt.username", "mqtt.url names a user, too; keep one of them")
        broker = replace(broker, username=config.username)
    secret = _password(config)
    if secret is None:
        return broker
    if broker.password is not None:
        raise CredentialsError("mqtt.url", "holds a password beside password_file or password_env; keep one of them")
    if broker.username is None:
        raise CredentialsError("mqtt.username", "is missing; a password needs a user name")
    return replace(broker, password=secret)


def tls_context(config: MqttConfig, broker: Broker) -> ssl.SSLContext | None:
    """None without TLS. Raises CredentialsError for a file that can't be used. Reads from disk."""
    if not broker.tls:
        if config.tls is not None:
            raise CredentialsError("mqtt.tls", 'needs url = "mqtts://..."; with mqtt:// nothing is encrypted')
        return None
    if config.tls is None:
        return ssl.create_default_context()
    tls = config.tls
    try:
        context = ssl.create_default_context(cafile=tls.ca_file)
    except (OSError, ssl.SSLError) as error:
        raise CredentialsError("mqtt.tls.ca_file", _words(error), tls.ca_file) from error
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if tls.cert_file is not None:
        secret = (
            None if tls.key_password_file is None else _line_of("mqtt.tls.key_password_file", tls.key_password_file)
        )
        try:
            # Without a password of ours OpenSSL would ask the terminal for one, and the gateway would hang there.
            context.load_cert_chain(tls.cert_file, tls.key_file, password=secret or "")
        except (OSError, ssl.SSLError) as error:
            said = f"with key_file {tls.key_file}: {_words(error)}"
            raise CredentialsError("mqtt.tls.cert_file", said, tls.cert_file) from error
    return context


def _password(config: MqttConfig) -> str | None:
    if config.password_file is not None:
        return _line_of("mqtt.password_file", config.password_file)
    if config.password_env is not None:
        secret = os.environ.get(config.password_env)
        if not secret:
            raise CredentialsError("mqtt.password_env", "no such variable in the environment", config.password_env)
        return secret
    return None


def _line_of(key: str, name: str) -> str:
    """The file's text less one newline at its end."""
    try:
        fd = os.open(name, os.O_RDONLY | os.O_NONBLOCK)
        with os.fdopen(fd, "rb") as file:
            if not stat.S_ISREG(os.fstat(fd).st_mode):  # read more than once, and a pipe would be waited for
                raise CredentialsError(key, "must be a plain file", name)
            data = file.read(MAX_FILE_BYTES + 1)
        text = data.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        raise CredentialsError(key, error.strerror or str(error), name) from error
    except UnicodeDecodeError:
        raise CredentialsError(key, "not UTF-8 text", name) from None
    if not text or len(text.encode()) > MAX_BYTES or "\n" in text:
        raise CredentialsError(key, f"must hold one line of 1 to {MAX_BYTES} bytes", name)
    return text


def _words(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        reason = (error.reason or "not a certificate, or the key does not belong to it").lower().replace("_", " ")
        return f"not usable: {reason}"
    return error.strerror or str(error)
