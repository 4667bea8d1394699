"""What is checked and reported of the files of [modbus.tls] before any client connects."""

import subprocess
from datetime import timedelta
from pathlib import Path

import pytest

from gateway import config_check
from gateway.certs import issue
from gateway.certs.client_certificate import revoked, subject_of, validity_of
from gateway.cli.main import main
from gateway.clock import SystemClock
from gateway.config import ModbusConfig, load, parse
from gateway.errors import ConfigError
from gateway.modbus.protocol.answers import Access, Peer
from gateway.modbus.server.limits import Refusal
from gateway.modbus.server.modbus_service import serving
from gateway.modbus.server.tls import ModbusTls
from gateway.net import tls
from gateway.net.tls import TlsFiles
from tests.plant_certs import NOW, LaterClock, Plant
from tests.virtual_time import in_real_time

NS = 1_000_000_000


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    made = Plant(tmp_path_factory.mktemp("certs"))
    made.client("plc1")
    return made


def wall_ns(days: float) -> int:
    return round((NOW + timedelta(days=days)).timestamp() * NS)


def test_good_files(plant: Plant) -> None:
    context = tls.server_context(TlsFiles.of_modbus(plant.config()))
    assert context.verify_mode.name == "CERT_REQUIRED"
    assert context.minimum_version.name == "TLSv1_2"
    assert tls.warnings(TlsFiles.of_modbus(plant.config()), wall_ns(0)) == []
    tls.server_context(TlsFiles.of_modbus(plant.config(crl=None)))


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [
        ("cert", None, "modbus.tls.cert: cannot read "),
        ("key", None, "modbus.tls.key: cannot read "),
        ("ca", None, "modbus.tls.ca: cannot read "),
        ("crl", None, "modbus.tls.crl: cannot read "),
        ("cert", "nonsense", "not a certificate and its private key"),
        ("key", "nonsense", "not a certificate and its private key"),
        ("ca", "nonsense", "modbus.tls.ca: "),
        ("crl", "nonsense", "modbus.tls.crl: "),
        ("key", "other key", "key values mismatch"),
        ("ca", "a client", "holds no certificate of an authority"),
        ("crl", "a client", "holds no revocation list"),
    ],
)
def test_bad_files(plant: Plant, tmp_path: Path, key: str, text: str | None, message: str) -> None:
    path = tmp_path / "file.pem"
    if text is not None:
        known = {"other key": plant.folder.key_path("plc1"), "a client": plant.folder.certificate_path("plc1")}
        path.write_bytes(known[text].read_bytes() if text in known else text.encode())
    with pytest.raises(ConfigError) as caught:
        tls.server_context(TlsFiles.of_modbus(plant.config(**{key: str(path)})))
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_key_with_a_passphrase_is_no_key_for_a_service(plant: Plant, tmp_path: Path) -> None:
    locked = tmp_path / "locked.key"
    key = str(plant.folder.key_path("gateway"))
    lock = ["openssl", "ec", "-aes128", "-passout", "pass:secret", "-in", key, "-out", str(locked)]
    subprocess.run(lock, check=True, capture_output=True)
    with pytest.raises(ConfigError, match="the key has a passphrase"):
        tls.server_context(TlsFiles.of_modbus(plant.config(key=str(locked))))


def test_warnings(plant: Plant, tmp_path: Path) -> None:
    (soon,) = tls.warnings(TlsFiles.of_modbus(plant.config()), wall_ns(20.5))
    assert soon.startswith("modbus.tls.cert: ")
    assert soon.endswith("in 9 days")
    (late,) = tls.warnings(TlsFiles.of_modbus(plant.config()), wall_ns(31))
    assert "expired on" in late
    assert "no client will connect; renew it" in late
    key = tmp_path / "open.key"
    key.write_bytes(plant.folder.key_path("gateway").read_bytes())
    key.chmod(0o644)
    (open_key,) = tls.warnings(TlsFiles.of_modbus(plant.config(key=str(key))), wall_ns(0))
    assert open_key == f"modbus.tls.key: {key} can be read by others; chmod o-rwx"


def test_gateway_check_names_the_line(plant: Plant, tmp_path: Path) -> None:
    text = '[modbus.tls]\nport = 0\ncert = "no.pem"\nkey = "no.key"\nca = "no.pem"\n'
    config = parse({"modbus": {"tls": {"port": 0, "cert": "no.pem", "key": "no.key", "ca": "no.pem"}}}, text=text)
    with pytest.raises(ConfigError) as caught:
        config_check.check(config, source="g.toml", text=text)
    assert str(caught.value) == "g.toml:1: modbus.tls: cert: cannot read no.pem: No such file or directory"


@pytest.mark.parametrize(
    ("modbus", "message"),
    [
        (
            {"handshake": {"heartbeat_required": False, "enable_required": True}},
            "modbus.handshake.enable_required = true: needs heartbeat_required",
        ),
        (
            {"handshake": {"enable_required": True}},
            "modbus.handshake.enable_required = true: needs modbus.writes = true: no PLC could set the bit",
        ),
        (
            {"handshake": {"truck_required": True}, "writes": False},
            "modbus.handshake.truck_required = true: needs modbus.writes = true",
        ),
        (
            {"handshake": {"spout_up_required": True}, "writes": False},
            "modbus.handshake.spout_up_required = true: needs modbus.writes = true",
        ),
        (
            {"writes": True},
            "modbus.writes = true: needs the permitted writers: set modbus.plc_addresses to the PLC's address, such as "
            '["10.20.0.10"] (in a simulation ["127.0.0.1"]), or [modbus.tls] with write_roles',
        ),
        ({"plain": False}, "modbus.plain = false: nothing would be served: plain = false needs [modbus.tls]"),
        ({"port": 802, "tls": {"cert": "a", "key": "b", "ca": "c"}}, "802 is modbus.port, too"),
        ({"tls": {"cert": "a", "key": "b"}}, "modbus.tls.ca: is missing"),
    ],
)
def test_combinations_that_are_refused(modbus: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse({"modbus": modbus})
    assert message in str(caught.value)


def test_roles(plant: Plant) -> None:
    roles = ModbusTls(plant.config(read_roles=["viewer", "both"], write_roles=["operator", "both"]), SystemClock())
    found = {role: roles.access(role) for role in ("viewer", "operator", "both", "Viewer", "", None)}
    assert found == {
        "viewer": Access.READ,
        "operator": Access.WRITE,
        "both": Access.WRITE,
        "Viewer": Access.NONE,
        "": Access.NONE,
        None: Access.NONE,
    }


def test_a_certificate_is_checked_for_as_long_as_it_is_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    own, clock = Plant(tmp_path), LaterClock()
    days = clock.days
    first, second = own.client("plc1"), own.client("plc2")  # for 30 days
    files = ModbusTls(own.config(), clock)
    one, other = (Peer("10.0.0.9", certificate=validity_of(certificate)) for certificate in (first, second))
    days.append(21.5)
    for _ in range(1000):
        assert files.ended(one) is files.ended(other) is files.ended(Peer("10.0.0.8")) is None
    assert caplog.text.count("10.0.0.9: its certificate () expires in 8 days, which ends its connection") == 2
    own.revoke(first)
    days.append(0.001)
    assert (files.ended(one), files.ended(other)) == (Refusal.CERTIFICATE_REVOKED, None)
    own.folder.crl_path.write_text("nonsense")
    days.append(0.001)
    assert (files.ended(one), files.ended(other)) == (Refusal.CERTIFICATE_REVOKED, None), "as it was read before"
    days.append(8.4)
    assert files.ended(other) is None
    days.append(0.1)
    assert files.ended(other) is Refusal.CERTIFICATE_EXPIRED


def test_lists_of_several_authorities_in_one_file(tmp_path: Path) -> None:
    plants = [Plant(tmp_path / "a"), Plant(tmp_path / "b")]
    taken = [plant.client("plc1") for plant in plants]
    for plant, certificate in zip(plants, taken, strict=True):
        plant.revoke(certificate)
    both = b"# two lists\n" + b"".join(plant.folder.crl_path.read_bytes() for plant in plants)
    assert {serial for _, serial in revoked(both)} == {certificate.serial_number for certificate in taken}
    with pytest.raises(ValueError, match=r"."):
        revoked(b"-----BEGIN X509 CRL-----\nnonsense\n-----END X509 CRL-----\n")


def test_gateway_check_shows_what_would_be_served(
    plant: Plant, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = plant.config().model_dump()
    tls_keys = "\n".join(f'{key} = "{keys[key]}"' for key in ("cert", "key", "ca", "crl"))
    path = tmp_path / "g.toml"
    path.write_text(f"[modbus]\nplain = false\nwrites = true\n[modbus.tls]\n{tls_keys}\n")
    assert main(["check", str(path)]) == 0
    output = capsys.readouterr().out
    assert "good. Site site1, Modbus/TCP Security on 127.0.0.1:802,\n" in output
    assert "writes to the handshake block: over TLS only, by role operator\n" in output
    path.write_text('[modbus]\nwrites = true\nplc_addresses = ["10.20.0.10", "10.20.0.11"]\n')
    main(["check", str(path)])
    output = capsys.readouterr().out
    assert "Modbus TCP on 127.0.0.1:502,\n  writes to the handshake block: by 10.20.0.10, 10.20.0.11\n" in output


def test_writes_without_permitted_writers_are_an_error_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_text("[modbus]\nhost = '10.20.0.5'\nwrites = true\n")
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:3: modbus.writes = true: needs the permitted writers: set modbus.plc")


@pytest.mark.parametrize(
    ("keys", "warned"),
    [
        ('host = "10.20.0.5"', True),
        ('host = "0.0.0.0"\nallow = ["10.20.0.0/16"]', True),
        ('host = "gateway.plant"', True),
        ('host = "10.20.0.5"\nplc_addresses = ["10.20.0.10"]', False),
        ('host = "localhost"', False),
        ('host = "::1"', False),
        ("", False),
    ],
)
def test_a_plant_without_plc_addresses_is_warned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: str, warned: bool
) -> None:
    path = tmp_path / "g.toml"
    path.write_text(f"[modbus]\n{keys}\n")
    assert main(["check", str(path)]) == 0
    output = capsys.readouterr().out
    assert ("  warning: modbus.plc_addresses: is empty, and host = " in output) == warned


@in_real_time
async def test_the_warning_is_in_the_log_of_a_gateway_that_starts(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.config.sections.modbus.is_loopback", lambda host: False)  # tests never leave loopback

    async with serving(ModbusConfig(port=0), {}, SystemClock()):
        pass
    (record,) = [one for one in caplog.records if "modbus.plc_addresses: is empty" in one.getMessage()]
    assert record.levelname == "WARNING"


@pytest.mark.parametrize("key", ["cert", "key", "ca", "crl"])
def test_a_file_that_vanishes_while_it_is_read_is_reported(
    plant: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    """Somebody renews the certificates at this moment: no traceback, and the files read before stay in force."""
    copy = tmp_path / "copy.pem"
    copy.write_bytes(Path(getattr(plant.config(), key)).read_bytes())
    config = plant.config(**{key: str(copy)})
    monkeypatch.setattr(
        tls, "_check_readable", lambda _, path: copy.unlink(missing_ok=True) if path == str(copy) else None
    )
    with pytest.raises(ConfigError, match=f"modbus.tls.{key}.*No such file|no such file"):
        tls.server_context(TlsFiles.of_modbus(config))


def test_a_subject_can_not_forge_a_log_line(plant: Plant) -> None:
    name = "plc1\n2026-01-01 INFO bay1: stop cleared\u2028\x1b[2J"
    made = issue.client(plant.by, name, "operator", issue.new_key(), NOW, 5)
    shown = subject_of(made)
    assert shown.startswith("plc1\N{REPLACEMENT CHARACTER}2026")
    assert shown.isprintable()
    assert len(shown.splitlines()) == 1
