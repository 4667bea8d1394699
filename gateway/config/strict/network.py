"""An address or a network of addresses, as a configuration writes it."""

from ipaddress import ip_address, ip_network


def network(text: str) -> str:
    """`text` as it is, if it is an IPv4 or IPv6 address or network. Raises ValueError that says what to write."""
    try:
        ip_network(text)
    except ValueError as error:
        said = "has bits set beyond its network part" if "host bits" in str(error) else "is neither"
        raise ValueError(f"should be an address or a network, such as 10.0.0.7 or 10.0.0.0/24; this {said}") from None
    return text


def is_loopback(host: str) -> bool:
    """Only this machine's own processes can connect. A name other than localhost may mean anything."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
