"""What every answer says to the browser about itself. Pure."""

from gateway.config.sections.hmi import HmiConfig

# Nothing from elsewhere, nothing inline, in nobody's frame. blob: are the pages' own pictures.
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'self'",
        "img-src 'self' blob: data:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
PERMISSIONS_POLICY = (
    "accelerometer=(), camera=(), display-capture=(), geolocation=(), gyroscope=(), magnetometer=(), microphone=(), "
    "midi=(), payment=(), usb=(), fullscreen=(self), screen-wake-lock=(self)"
)
HSTS_S = 30 * 86_400
HTTPS_PORT = 443


def security_headers(config: HmiConfig) -> tuple[tuple[bytes, bytes], ...]:
    """For every answer, whatever it says. Names in lower case."""
    said = {
        "content-security-policy": CONTENT_SECURITY_POLICY,
        "x-content-type-options": "nosniff",
        "x-frame-options": "DENY",  # for kiosk browsers too old for frame-ancestors
        "referrer-policy": "same-origin",
        "permissions-policy": PERMISSIONS_POLICY,
        "cross-origin-resource-policy": "same-origin",
    }
    if config.tls or config.loopback:  # elsewhere browsers ignore it, and complain
        said["cross-origin-opener-policy"] = "same-origin"
    if config.tls and config.port == HTTPS_PORT:  # it holds for all ports of this host, other programs' pages included
        said["strict-transport-security"] = f"max-age={HSTS_S}"
    return tuple((name.encode(), value.encode()) for name, value in said.items())


def cache_control(path: str) -> bytes:
    """Scripts and styles are asked for anew when they have changed; the plant's data is kept nowhere."""
    return b"no-cache" if path.startswith("/static/") else b"no-store"
