"""A camera's password that was typed on a page: in a file of the gateway's own, for the address it was typed for."""

from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.web.host.camera_passwords import CameraPasswords
from gateway.web.profile.stored_passwords import faults

URL = "rtsp://10.0.0.9:554/main"


def test_only_the_gateways_user_reads_it(tmp_path: Path) -> None:
    path = CameraPasswords().keep(tmp_path, URL, "geheim", [])
    assert path.read_text() == "geheim\n"
    assert (path.stat().st_mode & 0o777, path.parent.stat().st_mode & 0o777) == (0o600, 0o700)


def test_what_nothing_names_goes_and_what_a_configuration_names_stays(tmp_path: Path) -> None:
    passwords = CameraPasswords()
    first = passwords.keep(tmp_path, URL, "1", [])
    others = [passwords.keep(tmp_path, URL, str(n), [f'password_file = "{first}"']) for n in range(6)]
    assert first.exists()
    assert [path.exists() for path in others] == [False, False, True, True, True, True]


@pytest.mark.parametrize(("url", "password"), [(URL, ""), (URL, "a\nb"), ("rtsp://tom:x@10.0.0.9/", "geheim")])
def test_what_is_no_password_is_refused(tmp_path: Path, url: str, password: str) -> None:
    with pytest.raises(ConfigError, match="one line of text"):
        CameraPasswords().keep(tmp_path, url, password, [])
    with pytest.raises(ConfigError, match="state_dir"):
        CameraPasswords().keep(None, URL, "geheim", [])


@pytest.mark.parametrize(
    ("url", "file", "permitted"),
    [(URL, "/s/1", True), ("rtsp://10.0.0.66:554/main", "/s/1", False), (URL, "/etc/other", False)],
)
def test_it_may_be_named_with_its_own_address_alone(url: str, file: str, *, permitted: bool) -> None:
    camera = {"url": url, "username": "admin", "password_file": file}
    after = {"bays": {"A": {"camera": camera}}}
    assert (faults({}, after, f"{url} {file}", {"/s/1": URL}) == {}) is permitted
