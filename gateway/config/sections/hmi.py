"""`[hmi]`: the pages for operator, driver and technician, and who may see which. Pure."""

import re
from ipaddress import IPv6Address, ip_address
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gateway.config.sections.common import is_loopback
from gateway.config.strict import forms
from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section

ALL_ADDRESSES = ("0.0.0.0", "::")
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
MIN_MEMORY_KIB, MAX_MEMORY_KIB = (
    19_456,
    262_144,
)  # OWASP's smallest for argon2id; more than the other is not a login any more
MAX_PASSES = MAX_LANES = 16
_HASH = re.compile(
    r"\$argon2id\$v=19\$m=([1-9]\d{0,9}),t=([1-9]\d{0,9}),p=([1-9]\d{0,9})"
    r"\$[A-Za-z0-9+/]{11,86}\$[A-Za-z0-9+/]{22,171}"
)
USER_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
_LABELS = re.compile(r"(?!-)[a-z0-9_-]{1,63}(?<!-)(\.(?!-)[a-z0-9_-]{1,63}(?<!-))*")


def hash_text(text: str) -> str:
    """`text` as it is, if a login can be checked against it. Raises ValueError with the form required."""
    found = _HASH.fullmatch(text)
    if found is None:
        raise ValueError('should be what `gateway password` prints, "$argon2id$v=19$m=..."')
    memory, passes, lanes = map(int, found.groups())
    if not MIN_MEMORY_KIB <= memory <= MAX_MEMORY_KIB:
        raise ValueError(f"needs m={memory} KiB of memory; {MIN_MEMORY_KIB} to {MAX_MEMORY_KIB} are taken")
    if passes > MAX_PASSES or lanes > MAX_LANES:
        raise ValueError(f"t={passes}, p={lanes}; t up to {MAX_PASSES} and p up to {MAX_LANES} are taken")
    return text


def host_name(text: str) -> str:
    """`text` as a Host header is compared: lower case, no port, no brackets. Raises ValueError saying what to write."""
    folded = text.lower()
    try:
        return str(ip_address(folded.removeprefix("[").removesuffix("]")))
    except ValueError:
        pass
    if len(folded) > 253 or not _LABELS.fullmatch(folded) or folded.replace(".", "").isdigit():
        raise ValueError("should be one name or address as in the pages' address, without http:// and without port")
    return folded


def web_origin(text: str) -> str:
    """`text` as a browser names a site. Raises ValueError saying what to write."""
    found = re.fullmatch(r"(https?)://(.+?)(:[0-9]{1,5})?", text.lower())
    if found is None:
        raise ValueError("should be one site as in its pages' address, such as https://portal.plant.example")
    host = host_name(found[2])
    return f"{found[1]}://{f'[{host}]' if ':' in host else host}{found[3] or ''}"


def proxy_address(text: str) -> str:
    """`text` as addresses are compared: IPv4 inside IPv6 as IPv4. Raises ValueError for a name or a network."""
    try:
        address = ip_address(text)
    except ValueError:
        raise ValueError("should be one IP address, without port and mask") from None
    return str((address.ipv4_mapped if isinstance(address, IPv6Address) else None) or address)


PasswordHash = Annotated[str, AfterValidator(hash_text)]
HostName = Annotated[str, AfterValidator(host_name)]
WebOrigin = Annotated[str, AfterValidator(web_origin)]
ProxyAddress = Annotated[str, AfterValidator(proxy_address)]


class HmiUser(Section):
    """One who may log in. `gateway password` prints such a table."""

    name: str = Field(pattern=forms.USER_NAME, description="as typed at login; letters, digits, `.`, `_`, `-`")
    role: Literal["viewer", "technician"] = Field(
        "viewer", description="a viewer sees everything and acknowledges alarms; a technician also tunes and saves"
    )
    password_hash: PasswordHash = Field(
        repr=False, description="argon2id, as `gateway password` prints it; never the password itself"
    )


class HmiConfig(Section):
    enabled: bool = Field(False, description="serve the pages")
    host: HostName = Field("127.0.0.1", description="address to listen on; loopback: no access from outside")
    port: int = Field(8080, ge=0, le=65535, description="0 picks a free one")
    without_login: Literal["none", "driver", "viewer", "technician"] = Field(
        "driver", description="what anybody may do without a login; `technician` only where host is loopback"
    )
    users: tuple[HmiUser, ...] = Field((), max_length=64, description="who may log in")
    first_password: bool = Field(
        False,
        description="as long as there is no user, every page leads to one on which a browser of the same network makes "
        "the first technician; needs TLS (docs/hmi-security.md#the-first-password)",
    )
    run_as: str | None = Field(
        None,
        pattern=forms.SYSTEM_USER,
        description="user that the web process becomes where the gateway runs as root; it must be able to read the "
        "program and the TLS files; absent: the gateway's own user",
    )
    tls_cert: str | None = Field(
        None,
        min_length=1,
        description="PEM file: the pages' certificate, then any intermediate ones; absent: no TLS; auto: the gateway "
        "makes one for the names and addresses of this machine, and renews it (docs/hmi-security.md)",
    )
    tls_key: str | None = Field(
        None, min_length=1, description="PEM file: its private key, without a passphrase; absent with `auto`"
    )
    allowed_hosts: tuple[HostName, ...] = Field(
        (),
        max_length=64,
        description="names and addresses by which the pages are called; empty: host, on loopback also localhost; on "
        'all addresses, with `tls_cert = "auto"`, the names and addresses of this machine',
    )
    base_path: str = Field(
        "",
        max_length=200,
        pattern=forms.BASE_PATH,
        description="path below which a proxy serves the pages, such as `/bay1`; the proxy passes it on; empty: none",
    )
    trusted_proxies: tuple[ProxyAddress, ...] = Field(
        (),
        max_length=16,
        description="addresses of proxies whose X-Forwarded-For and X-Forwarded-Proto are believed: the client's "
        "address and scheme, nothing else; empty: none are read",
    )
    frame_ancestors: tuple[WebOrigin, ...] = Field(
        (),
        max_length=16,
        description="sites that may show the pages in a frame, such as `https://portal.plant.example`; empty: none",
    )
    setup_page: bool = Field(
        True,
        description="technicians may change every key of this file and restart the gateway on the page /setup; false: "
        "only who may write the file (docs/technician.md#change-any-other-setting)",
    )
    session_hours: float = Field(12.0, ge=0.1, le=168, description="a login ends after this time in any case")
    session_idle_minutes: float = Field(60.0, ge=1, le=10_080, description="and after this time without an open page")
    max_viewers: int = Field(64, ge=1, le=1000, description="live pages at the same time")
    viewers_per_address: int = Field(
        16, ge=1, le=1000, description="of max_viewers, for one address; more where all connect through one proxy"
    )
    languages_folder: str | None = Field(
        None,
        min_length=1,
        description="folder of a plant's own languages and words, one JSON file each "
        "(docs/technician.md#units-languages-browsers)",
    )
    picture_max_hz: float = Field(10.0, ge=0.5, le=60, description="of one bay's picture, for all viewers together")
    picture_max_width_px: int = Field(1280, ge=160, le=4096, description="wider pictures are made smaller")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        seen: set[str] = set()
        for n, user in enumerate(self.users):
            if user.name.lower() in seen:  # `Anna` beside `anna` is a trap
                raise FieldError(f"an earlier user has the name {user.name}, too", "users", n, "name")
            seen.add(user.name.lower())
        return self

    @model_validator(mode="after")
    def _login(self) -> Self:
        if self.without_login == "technician" and self.loopback and (self.trusted_proxies or self.base_path):
            raise FieldError(
                '"technician" opens tuning to anybody who reaches the proxy. Make users (gateway password), and set '
                '"none", "driver" or "viewer"',
                "without_login",
            )
        if self.without_login == "technician" and not self.loopback:
            raise FieldError(
                f'"technician" opens tuning to anybody who reaches {self.host}; it is allowed for loopback only. '
                'Make users (gateway password), and set "none", "driver" or "viewer"',
                "without_login",
            )
        if self.without_login == "none" and not self.users and not self.first_password:
            raise FieldError('"none" needs [[hmi.users]]: no user could log in (gateway password)', "without_login")
        return self

    @model_validator(mode="after")
    def _first(self) -> Self:
        if not self.first_password:
            return self
        against = {
            'without_login = "technician" needs no password': self.without_login == "technician",
            'it would be sent without TLS: set tls_cert, such as "auto"': not self.tls,
            "a proxy hides who is of this network: no base_path, no trusted_proxies": bool(
                self.base_path or self.trusted_proxies
            ),
            "setup_page = false lets only this file make users": not self.setup_page,
        }
        for why, holds in against.items():
            if holds:
                raise FieldError(why, "first_password")
        return self

    @model_validator(mode="after")
    def _pair(self) -> Self:
        if self.own_certificate:
            if self.tls_key is not None:
                raise FieldError('must be absent: tls_cert = "auto" makes its own', "tls_key")
            if self.run_as is not None:
                raise FieldError('"auto" makes a key that no other user can read: run_as must be absent', "tls_cert")
            return self
        for key, other in (("tls_cert", "tls_key"), ("tls_key", "tls_cert")):
            if getattr(self, key) is not None and getattr(self, other) is None:
                raise FieldError(f"needs {other}, too", key)
        return self

    @model_validator(mode="after")
    def _named(self) -> Self:
        if self.own_hosts and not self.own_certificate:
            raise FieldError(
                f"must name the host in the pages' URL: {self.host} is no such name, and pages that answer to any "
                "name let a foreign web site read them (DNS rebinding)",
                "allowed_hosts",
            )
        return self

    @property
    def loopback(self) -> bool:
        """Only this machine's own processes can connect."""
        return is_loopback(self.host)

    @property
    def tls(self) -> bool:
        return self.tls_cert is not None

    @property
    def awaits_first_user(self) -> bool:
        return self.first_password and not self.users

    @property
    def own_certificate(self) -> bool:
        return self.tls_cert == "auto"

    @property
    def own_hosts(self) -> bool:
        """Requests for the names and addresses of this machine are answered, whatever these are at the time."""
        return not self.allowed_hosts and self.host in ALL_ADDRESSES

    @property
    def hosts(self) -> frozenset[str]:
        """The Host headers (lower case, without port and brackets) that are answered."""
        if self.allowed_hosts:
            return frozenset(self.allowed_hosts)
        return frozenset((self.host, *LOOPBACK_NAMES) if self.loopback or self.own_hosts else (self.host,))

    def warnings(self) -> list[str]:
        """What works, and is still no good idea; one line each, with the key to edit."""
        warnings: list[str] = []
        if self.enabled and self.users and not self.loopback and not self.tls:
            warnings.append(
                f"hmi.tls_cert: is missing, and host = {self.host} is no loopback address: passwords and sessions "
                "travel unencrypted, and anybody who listens on the network can read them (docs/hmi-security.md)"
            )
        return warnings
