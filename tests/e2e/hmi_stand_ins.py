"""Web processes in strange hands, and one that takes long to start. A child process imports this module."""

import time

from gateway.processes.channel import Channel
from gateway.processes.codec import Codec
from gateway.web.ipc.messages import TO_WEB, FromWeb, StateRequest, ToWeb, WebSetup

CODEC = TO_WEB
LATE_S = 3.0


def run(channel: Channel[FromWeb, ToWeb], about: WebSetup) -> None:
    """Asks as fast as the socket takes it; hears the answers only if the gateway's configuration says so. Or it says
    what is no message, and then goes on asking. Or it behaves, but is late."""
    if about.config.instance == "late":
        time.sleep(LATE_S)
        while True:
            channel.send(StateRequest(1, ("bay1",)))
            channel.receive()
            time.sleep(0.1)
    if about.config.instance == "nonsense":
        channel.sock.send(b"\x91" * 60_000)
    hears = about.config.instance == "hears"
    question = Codec.packed(StateRequest(1, ("bay1",)))
    while True:
        try:
            channel.sock.setblocking(False)
            while True:
                channel.sock.send(question)
        except BlockingIOError:
            channel.sock.setblocking(True)
        if hears:
            channel.waiting()
        else:
            channel.sock.send(question)
