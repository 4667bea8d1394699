"""Web processes in strange hands. A child process imports this module."""

import pickle

from gateway.children.link import Link
from gateway.hmi.orders import Ask, FromHmi, HmiJob, ToHmi


def run(link: Link[FromHmi, ToHmi], job: HmiJob) -> None:
    """Asks as fast as the socket takes it; hears the answers only if the gateway's configuration says so."""
    hears = job.unpacked().config.instance == "hears"
    question = pickle.dumps(Ask(1, ("bay1",)))
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
