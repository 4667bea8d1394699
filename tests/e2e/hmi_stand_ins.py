"""Web processes in strange hands. A child process imports this module."""

from gateway.processes.channel import Link
from gateway.processes.codec import Codec
from gateway.web.ipc.messages import TO_WEB, FromWeb, StateRequest, ToWeb, WebSetup

CODEC = TO_WEB


def run(link: Link[FromWeb, ToWeb], about: WebSetup) -> None:
    """Asks as fast as the socket takes it; hears the answers only if the gateway's configuration says so. Or it says
    what is no message, and then goes on asking."""
    if about.config.instance == "nonsense":
        link.sock.send(b"\x91" * 60_000)
    hears = about.config.instance == "hears"
    question = Codec.packed(StateRequest(1, ("bay1",)))
    while True:
        try:
            link.sock.setblocking(False)
            while True:
                link.sock.send(question)
        except BlockingIOError:
            link.sock.setblocking(True)
        if hears:
            link.waiting()
        else:
            link.sock.send(question)
