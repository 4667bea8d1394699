"""TLS towards other systems. IO: reads small files."""

import ssl

from gateway.config.sections.common import ClientTls
from gateway.errors import SettingError
from gateway.passwords import one_line


def client_context(section: str, tls: ClientTls | None) -> ssl.SSLContext:
    """TLS that verifies the server's certificate and its name. `section`: where the keys are, for the errors.

    Raises SettingError for a file that can't be used.
    """
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


def _reason(error: OSError) -> str:
    if isinstance(error, ssl.SSLError):
        reason = (error.reason or "not a certificate, or the key does not belong to it").lower().replace("_", " ")
        return f"not usable: {reason}"
    return error.strerror or str(error)
