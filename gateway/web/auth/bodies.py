"""A request's body is read before its route runs: complete, in time, and not longer than its rule allows. IO."""

from starlette.types import Message, Receive, Scope

from gateway.clock import Clock
from gateway.web.auth.access import Rule
from gateway.web.auth.headers import header
from gateway.web.auth.refusals import RefusalError

BODY_S = 10.0  # a body must have arrived within this
CLOSE = {"Connection": "close"}  # or the rest of the body would be taken for the next request


async def complete_body(scope: Scope, receive: Receive, rule: Rule, clock: Clock) -> Receive:
    """A `receive` that has it all. Raises RefusalError (413, 408, 400)."""
    if scope["type"] != "http":
        return receive
    too_long = RefusalError(413, "too_long", f"at most {rule.body_bytes} bytes", headers=CLOSE, audited=True)
    try:
        length = header(scope["headers"], b"content-length")
    except ValueError:
        raise too_long from None
    if length is not None and not (length.isdigit() and len(length) < 10 and int(length) <= rule.body_bytes):
        raise too_long
    if rule.method != "POST":
        return receive  # no route reads a body without a length
    body = bytearray()
    try:
        async with clock.timeout(BODY_S):
            while (message := await receive())["type"] == "http.request":
                body += message.get("body", b"")
                if len(body) > rule.body_bytes:
                    raise too_long
                if not message.get("more_body", False):
                    return _replayed(bytes(body), receive)
    except TimeoutError:
        text = f"the request was not there within {BODY_S:g} s"
        raise RefusalError(408, "slow", text, headers=CLOSE) from None
    raise RefusalError(400, "gone", "the caller has disconnected")


def _replayed(body: bytes, receive: Receive) -> Receive:
    """`receive` that returns the complete body at once, and then continues as before."""
    first = True

    async def replayed() -> Message:
        nonlocal first
        if first:
            first = False
            return {"type": "http.request", "body": body, "more_body": False}
        return await receive()

    return replayed
