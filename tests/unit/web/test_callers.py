"""Host and Origin, by hand and wild."""

from urllib.parse import urlsplit

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.web.auth.headers import forwarded_for, host_allowed, host_and_port, safe_next, same_origin

HOSTS = {"10.0.0.5", "bay-pc", "::1"}


@pytest.mark.parametrize(
    ("authority", "found"),
    [
        ("10.0.0.5", ("10.0.0.5", 80)),
        ("10.0.0.5:8080", ("10.0.0.5", 8080)),
        ("BAY-pc:1", ("bay-pc", 1)),
        ("[::1]:8080", ("::1", 8080)),
        ("[0:0:0:0:0:0:0:1]", ("::1", 80)),
    ],
)
def test_hosts(authority: str, found: tuple[str, int]) -> None:
    assert host_and_port(authority, "http") == found
    assert host_allowed(authority, HOSTS, "http")


@pytest.mark.parametrize(
    "authority",
    ["", ":80", "10.0.0.5:", "10.0.0.5:0", "10.0.0.5:65536", "10.0.0.5:80:80", "10.0.0.5:+80", "10.0.0.5:8 0", "::1",
     "[::1", "::1]", "[::1]x", "[::1]:", "[[::1]]", "[10.0.0.5]", "a@10.0.0.5", "10.0.0.5/", "10.0.0.5?", "10.0.0.5#",
     "10.0.0.5\\", " 10.0.0.5", "10.0.0.5 ", "10.0.0.5,bay-pc", "10.0.0.5.", "10.0.0.5:٨٠", "bay-pc%00", "0x0a000005",
     "10.5", "167772165", "bay-pc.evil.example", "evil.example", "x" * 1000],
)  # fmt: skip
def test_no_hosts_of_ours(authority: str) -> None:
    assert not host_allowed(authority, HOSTS, "http")


@pytest.mark.parametrize(
    ("origin", "authority", "scheme", "same"),
    [
        ("http://10.0.0.5:8080", "10.0.0.5:8080", "http", True),
        ("http://10.0.0.5", "10.0.0.5:80", "http", True),
        ("https://10.0.0.5", "10.0.0.5:443", "https", True),
        ("http://bay-pc:8080", "BAY-PC:8080", "http", True),
        ("http://[::1]:8080", "[::1]:8080", "http", True),
        ("https://10.0.0.5:8080", "10.0.0.5:8080", "http", False),
        ("http://10.0.0.5:8080", "10.0.0.5:8080", "https", False),
        ("http://10.0.0.5:8081", "10.0.0.5:8080", "http", False),
        ("http://bay-pc:8080", "10.0.0.5:8080", "http", False),
        ("null", "10.0.0.5:8080", "http", False),
        (None, "10.0.0.5:8080", "http", False),
        ("http://u@10.0.0.5:8080", "10.0.0.5:8080", "http", False),
        ("http://10.0.0.5:8080/x", "10.0.0.5:8080", "http", False),
        ("http://10.0.0.5:8080 http://10.0.0.5:8080", "10.0.0.5:8080", "http", False),
        ("http://[::1:8080", "[::1]:8080", "http", False),
    ],
)
def test_origins(origin: str | None, authority: str, scheme: str, same: bool) -> None:
    assert same_origin(origin, authority, scheme) == same


@given(st.text(max_size=80))
@example("10.0.0.5\n")
@example("10.0.0.5\x00evil")
def test_wild_hosts_are_ours_only_if_they_say_so(text: str) -> None:
    if host_allowed(text, HOSTS, "http"):
        assert text.lower().strip("[]").partition(":")[0] in (*HOSTS, "") or text.lower().startswith(("[", "0"))


@given(st.text(max_size=80))
def test_wild_origins_are_no_origins(text: str) -> None:
    assert not same_origin(text, "10.0.0.5:8080", "http") or text == "http://10.0.0.5:8080"
    assert not same_origin("http://" + text, "10.0.0.5:8080", "http") or text == "10.0.0.5:8080"


@pytest.mark.parametrize(
    ("wanted", "goes"),
    [
        ("/tune/bay1", "/tune/bay1"),
        ("/tune/bay1?a=b&c=//d", "/tune/bay1?a=b&c=//d"),
        ("/", "/"),
        (None, "/"),
        (7, "/"),
        ("", "/"),
        ("tune", "/"),
        ("//evil.example", "/"),
        ("/\\evil.example", "/"),
        ("/\t/evil.example", "/"),
        ("/\n/evil.example", "/"),
        ("https://evil.example", "/"),
        ("javascript:alert(1)", "/"),
        ("/" + "x" * 1000, "/"),
    ],
)
def test_where_a_login_leads(wanted: object, goes: str) -> None:
    assert safe_next(wanted) == goes


@pytest.mark.parametrize("wanted", ["/", "/bay10/", "/wiki", "/bay1/../wiki", "/bay1/%2E%2e/wiki", "/bay1/x/.%2e/.."])
def test_a_login_leads_to_nothing_beside_the_base_path(wanted: str) -> None:
    assert safe_next(wanted, "/bay1") == "/bay1/"
    assert safe_next("/bay1/tune/A?next=/../x#/..", "/bay1") == "/bay1/tune/A?next=/../x#/.."


@pytest.mark.parametrize(
    ("listed", "address"),
    [
        ([], "10.0.0.1"),
        (["203.0.113.9"], "203.0.113.9"),
        (["127.0.0.1, 203.0.113.9"], "203.0.113.9"),  # the client's own invention stands left
        (["127.0.0.1", "203.0.113.9"], "203.0.113.9"),
        (["1.1.1.1, 203.0.113.9, 10.0.0.2"], "203.0.113.9"),  # through both proxies
        (["10.0.0.2"], "10.0.0.2"),
        (["1.1.1.1, unknown"], "10.0.0.1"),
        (["1.1.1.1, 203.0.113.9:4711"], "10.0.0.1"),
        (["1.1.1.1,"], "10.0.0.1"),
        (["::ffff:203.0.113.9"], "203.0.113.9"),
    ],
)
def test_only_what_a_named_proxy_has_added_is_an_address(listed: list[str], address: str) -> None:
    headers = [(b"x-forwarded-for", text.encode()) for text in listed]
    assert forwarded_for(headers, "10.0.0.1", {"10.0.0.1", "10.0.0.2"}) == address
    assert forwarded_for(headers, "::ffff:10.0.0.1", {"10.0.0.1", "10.0.0.2"}) == address
    assert forwarded_for(headers, "10.0.0.3", {"10.0.0.1", "10.0.0.2"}) == "10.0.0.3"


@given(st.text(st.sampled_from("/\\a.:@\t\n ?#e"), max_size=12))
def test_a_login_never_leads_away(text: str) -> None:
    for wanted in (text, "/" + text):
        found = safe_next(wanted)
        assert urlsplit(found).netloc == urlsplit(found).scheme == ""
        assert found.startswith("/")
        assert found[1:2] not in ("/", "\\")
