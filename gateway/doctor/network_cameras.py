"""Network cameras found by WS-Discovery and asked for their streams. IO, and blocks. What is said is in `onvif`."""

import http.client
import secrets
import select
import socket
import struct
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from urllib.parse import urlsplit
from uuid import uuid4

from gateway.clock import Clock
from gateway.doctor import onvif
from gateway.durations import NS_PER_S
from gateway.errors import GatewayError, LinkError, ProtocolError
from gateway.web.ipc.devices import FoundNetworkCamera, FoundNetworkCameras, NetworkStreams

GROUP = ("239.255.255.250", 3702)
SEARCH_S, AGAIN_S = 3.0, 1.0  # in all; a datagram may be lost, so the probe is sent once more
ANSWER_S = 4.0  # for one request
MOST = 64  # cameras
MOST_ANSWERS = 512  # datagrams: whoever floods gets no more
DATAGRAM_BYTES = 65_536


def search(addresses: Sequence[str], clock: Clock, group: tuple[str, int] = GROUP) -> FoundNetworkCameras:
    """`addresses`: of this machine; one in each network that is searched."""
    cameras: dict[str, FoundNetworkCamera] = {}
    data, begun_ns, sent, answers = onvif.probe(str(uuid4())), clock.now_ns(), 0, 0
    with ExitStack() as opened:
        sockets = [opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in addresses]
        for sock, address in zip(sockets, addresses, strict=True):
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("b", 1))
            with suppress(OSError):  # the network of this address has gone
                sock.bind((address, 0))
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
        while (gone_s := (clock.now_ns() - begun_ns) / NS_PER_S) < SEARCH_S and len(cameras) < MOST:
            if gone_s >= sent * AGAIN_S and sent < 2:
                sent += 1
                for sock in sockets:
                    with suppress(OSError):
                        sock.sendto(data, group)
            for sock in select.select(sockets, [], [], 0.1)[0]:
                answers += 1
                with suppress(OSError, ProtocolError):
                    answer, (sender, *_) = sock.recvfrom(DATAGRAM_BYTES)
                    if (camera := onvif.found(answer, sender)) is not None:
                        cameras[sender] = camera
            if answers > MOST_ANSWERS:
                break
    return FoundNetworkCameras(tuple(sorted(cameras.values(), key=lambda camera: socket.inet_aton(camera.address))))


def streams(service: str, username: str, password: str, clock: Clock) -> NetworkStreams:
    """What the camera behind `service` offers, or why not."""
    now = datetime.fromtimestamp(clock.wall_ns() / NS_PER_S, UTC)
    talk = onvif.conversation(service, username, password, now, lambda: secrets.token_bytes(16))
    try:
        post = next(talk)
        while True:
            post = talk.send(_reply(post))
    except StopIteration as end:
        return NetworkStreams(end.value, login=False, why="" if end.value else "it offers no stream at its own address")
    except onvif.LoginError as error:
        return NetworkStreams((), login=True, why=str(error) if username else "")
    except GatewayError as error:
        return NetworkStreams((), login=False, why=str(error))


def _reply(post: onvif.Post) -> onvif.Reply:
    """Raises LinkError."""
    parts = urlsplit(post.url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port or 80, timeout=ANSWER_S)
    try:
        path = f"{parts.path or '/'}{'?' if parts.query else ''}{parts.query}"
        connection.request("POST", path, post.data, {"Content-Type": "application/soap+xml; charset=utf-8"})
        answer = connection.getresponse()
        return onvif.Reply(answer.status, answer.read(onvif.MAX_BYTES + 1))
    except (OSError, http.client.HTTPException) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise LinkError(f"{parts.hostname}: {why}") from error
    finally:
        connection.close()
