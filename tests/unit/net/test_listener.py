"""Who must act when the port can't be had: the operator (ConfigError) or time (LinkError)."""

import errno
import os
import socket

import pytest

from gateway.errors import ConfigError, GatewayError, LinkError
from gateway.net.listener import bind_error


def os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.parametrize(
    ("error", "kind", "why"),
    [
        (os_error(errno.EACCES), ConfigError, "setcap cap_net_bind_service"),
        (os_error(errno.EPERM), ConfigError, "setcap cap_net_bind_service"),
        (os_error(errno.EADDRINUSE), LinkError, "another program listens there already"),
        (os_error(errno.EADDRNOTAVAIL), LinkError, "does not have that address"),
        (os_error(errno.EMFILE), LinkError, "Too many open files"),
        (OSError("could not bind on any address out of [...]"), LinkError, "could not bind on any address"),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), ConfigError, "neither an address nor"),
        (socket.gaierror(socket.EAI_AGAIN, "Temporary failure"), LinkError, "can't be resolved now"),
        (UnicodeError("label too long"), ConfigError, "label too long"),
    ],
)
def test_bind_error(error: Exception, kind: type[GatewayError], why: str) -> None:
    found = bind_error("modbus", "10.0.0.9", 502, error)
    assert type(found) is kind
    assert str(found).startswith("modbus: cannot listen on 10.0.0.9 port 502: ")
    assert why in str(found)
