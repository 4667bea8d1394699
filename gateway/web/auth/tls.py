"""TLS of the pages: the context made from the files of `[hmi]`, and renewed when they change. IO: reads them."""

import logging
import ssl

from gateway.certs import pair
from gateway.clock import NS_PER_S, Clock
from gateway.config.sections.hmi import HmiConfig
from gateway.errors import ConfigError

log = logging.getLogger(__name__)

CIPHERS = "ECDHE+AESGCM:ECDHE+CHACHA20"  # of TLS 1.2: forward secrecy and authenticated encryption; 1.3 has no others
LOOK_S = 60.0
WARN_S = 24 * 3600  # a gateway runs for years


def server_context(config: HmiConfig) -> ssl.SSLContext | None:
    """None: without TLS. Raises ConfigError, naming key and file, for files that can't be used."""
    if config.tls_cert is None or config.tls_key is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers(CIPHERS)
    context.set_alpn_protocols(["http/1.1"])
    context.options |= ssl.OP_NO_RENEGOTIATION
    pair.load_pair(context, ("hmi.tls_cert", config.tls_cert), ("hmi.tls_key", config.tls_key))
    return context


def warnings(config: HmiConfig, wall_ns: int) -> list[str]:
    """What an operator should mend soon: a certificate about to expire, a key that others may read."""
    if config.tls_cert is None or config.tls_key is None:
        return []
    try:
        return pair.warnings([("hmi.tls_cert", config.tls_cert)], ("hmi.tls_key", config.tls_key), wall_ns)
    except (OSError, ValueError) as error:
        return [f"hmi.tls_cert: {config.tls_cert}: can't be looked at: {error}"]


async def keep_fresh(context: ssl.SSLContext, config: HmiConfig, clock: Clock) -> None:
    """For ever: a renewed certificate holds for every connection made from then on, without a restart.

    Files that are no good any more are told, and the last good ones go on. What should be mended is told once a day.
    """
    files = (config.tls_cert, config.tls_key)
    stamps, warned_ns = pair.stamps(*files), None
    while True:
        if warned_ns is None or clock.now_ns() - warned_ns >= WARN_S * NS_PER_S:
            warned_ns = clock.now_ns()
            for line in warnings(config, clock.wall_ns()):
                log.warning("%s", line)
        await clock.sleep(LOOK_S)
        newer = pair.stamps(*files)
        if newer == stamps:
            continue
        stamps = newer
        try:
            server_context(config)  # a trial: a context that has taken half of a pair would serve nobody
            pair.load_pair(context, ("hmi.tls_cert", config.tls_cert or ""), ("hmi.tls_key", config.tls_key or ""))
        except ConfigError as error:
            log.error("%s; the files read before stay in force", error)
        else:
            log.warning("hmi: the certificate was read anew")
