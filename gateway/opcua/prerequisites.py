"""What must be there before the server starts: its library, and a certificate that its security policy can use."""

import importlib.util
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey

from gateway.config import OpcuaConfig
from gateway.errors import ConfigError
from gateway.net import tls
from gateway.net.tls import TlsFiles


def check(config: OpcuaConfig) -> None:
    """Raises ConfigError. Imports nothing of the library."""
    if importlib.util.find_spec("asyncua") is None:
        raise ConfigError("opcua: needs a library that is not installed: pip install 'plc-loading-gateway[opcua]'")
    if (files := TlsFiles.of_opcua(config)) is None:
        return
    tls.check(files)
    if not isinstance(x509.load_pem_x509_certificate(Path(files.cert).read_bytes()).public_key(), RSAPublicKey):
        raise ConfigError(f"opcua.cert: {files.cert} has no RSA key: gateway certs server --uri makes one")
