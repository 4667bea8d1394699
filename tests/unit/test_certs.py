"""gateway certs: what it makes is what Modbus/TCP Security wants, and it destroys nothing."""

import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID
from hypothesis import given
from hypothesis import strategies as st

from gateway.certs import client_certificate as roles
from gateway.certs.folder import Folder
from gateway.cli.main import main


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Folder:
    monkeypatch.chdir(tmp_path)
    assert main(["certs", "init"]) == 0
    return Folder(tmp_path / "certs")


def openssl(*args: str | Path) -> str:
    done = subprocess.run(["openssl", *map(str, args)], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_with_a_uri_the_lines_for_the_opc_ua_server_are_said(plant: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["certs", "server", "--name", "opcua", "--uri", "urn:plant:gateway1", "--host", "10.0.0.5"]) == 0
    said = capsys.readouterr().out
    assert '[opcua]\ncert = "certs/opcua.pem"\nkey = "certs/opcua.key"\nca = "certs/ca.pem"\n' in said
    assert "[hmi]" not in said
    assert "[modbus" not in said


@pytest.mark.long
@pytest.mark.one_interpreter
def test_a_whole_plant(plant: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["certs", "server", "--host", "10.0.0.5", "--host", "gateway.plant.example", "--host", "::1"]) == 0
    said = capsys.readouterr().out
    assert '[hmi]\ntls_cert = "certs/gateway.pem"\ntls_key = "certs/gateway.key"\n' in said
    assert '[modbus.tls]\ncert = "certs/gateway.pem"\nkey = "certs/gateway.key"\nca = "certs/ca.pem"\n' in said
    assert "good until" in said
    assert main(["certs", "client", "plc1"]) == 0
    assert main(["certs", "client", "hmi1", "--role", "viewer", "--rsa", "--days", "10"]) == 0
    said = capsys.readouterr().out
    assert "role viewer. Copy to hmi1, and nowhere else:\n  certs/hmi1.pem\n  certs/hmi1.key\n  certs/ca.pem\n" in said

    ca = plant.certificate_path("ca")
    for name, purpose in (("gateway", "sslserver"), ("plc1", "sslclient"), ("hmi1", "sslclient")):
        path = plant.certificate_path(name)
        assert f"{path}: OK" in openssl("verify", "-x509_strict", "-purpose", purpose, "-CAfile", ca, path)
        other = "sslclient" if purpose == "sslserver" else "sslserver"
        assert "unsuitable certificate purpose" in openssl("verify", "-purpose", other, "-CAfile", ca, path)
        assert stat.S_IMODE(plant.key_path(name).stat().st_mode) == 0o600
    assert stat.S_IMODE(plant.key_path("ca").stat().st_mode) == 0o600
    assert stat.S_IMODE(plant.path.stat().st_mode) == 0o700
    names = plant.certificate("gateway").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert sorted(str(name.value) for name in names) == ["10.0.0.5", "::1", "gateway.plant.example"]
    assert [roles.role_of(plant.certificate(name)) for name in plant.names()] == [None, None, "viewer", "operator"]
    assert isinstance(plant.key("hmi1"), rsa.RSAPrivateKey)

    assert main(["certs", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [
        ["ca", "authority"],
        ["gateway", "-"],
        ["hmi1", "viewer"],
        ["plc1", "operator"],
    ]
    assert "renew it soon" in lines[2]
    assert "renew" not in lines[3]


def test_the_role_is_an_asn1_utf8string_as_openssl_reads_it(plant: Folder) -> None:
    main(["certs", "client", "plc1", "--role", "Opérateur"])
    text = openssl("asn1parse", "-in", plant.certificate_path("plc1"))
    after = text.split("1.3.6.1.4.1.50316.802.1")[1]
    wanted = "Opérateur".encode()
    assert f"[HEX DUMP]:0C{len(wanted):02X}{wanted.hex().upper()}" in after.split("\n")[1]
    assert roles.role_of(plant.certificate("plc1")) == "Opérateur"


@pytest.mark.parametrize(
    "again", [["init"], ["server"], ["client", "plc1"], ["client", "ca"], ["client", "gateway"]], ids=" ".join
)
def test_nothing_is_overwritten(plant: Folder, capsys: pytest.CaptureFixture[str], again: list[str]) -> None:
    main(["certs", "server"])
    main(["certs", "client", "plc1"])
    before = {path: path.read_bytes() for path in plant.path.iterdir()}
    assert main(["certs", *again]) == 2
    assert "exists already; nothing is overwritten" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in plant.path.iterdir()} == before


def test_renew_keeps_key_role_and_hosts(plant: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    main(["certs", "server", "--host", "10.0.0.5", "--days", "3"])
    main(["certs", "client", "plc1", "--days", "3"])
    for name in ("gateway", "plc1"):
        old, key = plant.certificate(name), plant.key_path(name).read_bytes()
        assert main(["certs", "renew", name]) == 0
        new = plant.certificate(name)
        assert plant.key_path(name).read_bytes() == key
        assert new.public_key() == old.public_key()
        assert new.serial_number != old.serial_number
        assert (new.not_valid_after_utc - old.not_valid_after_utc).days == 825 - 3
        assert {e.oid for e in new.extensions} == {e.oid for e in old.extensions}
        assert roles.role_of(new) == roles.role_of(old)
        assert ": OK" in openssl("verify", "-CAfile", plant.certificate_path("ca"), plant.certificate_path(name))
    hosts = plant.certificate("gateway").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(host.value) for host in hosts] == ["10.0.0.5"]
    assert "was good until" in capsys.readouterr().out


def test_revoke(plant: Folder, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("plc1", "hmi1"):
        main(["certs", "client", name])
        assert main(["certs", "revoke", name]) == 0
        assert main(["certs", "revoke", name]) == 0, "twice does no harm"
    crl = plant.crl()
    assert crl is not None
    assert {entry.serial_number for entry in crl} == {plant.certificate(n).serial_number for n in ("plc1", "hmi1")}
    check = ("verify", "-crl_check", "-CRLfile", plant.crl_path, "-CAfile", plant.certificate_path("ca"))
    assert "certificate revoked" in openssl(*check, plant.certificate_path("plc1"))
    main(["certs", "client", "good"])
    assert ": OK" in openssl(*check, plant.certificate_path("good"))
    capsys.readouterr()
    main(["certs", "list"])
    assert capsys.readouterr().out.count("revoked") == 2


def test_no_certificate_outlives_its_authority(plant: Folder) -> None:
    main(["certs", "client", "plc1", "--days", "36500"])
    assert plant.certificate("plc1").not_valid_after_utc == plant.certificate("ca").not_valid_after_utc


def test_an_authority_can_not_make_another(plant: Folder) -> None:
    constraints = plant.certificate("ca").extensions.get_extension_for_class(x509.BasicConstraints).value
    assert (constraints.ca, constraints.path_length) == (True, 0)
    main(["certs", "client", "plc1"])
    use = plant.certificate("plc1").extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(use) == [ExtendedKeyUsageOID.CLIENT_AUTH]


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["client", "../plc1"], "'../plc1' is no name for a certificate"),
        (["client", "crl"], "'crl' is no name for a certificate"),
        (["client", "plc1", "--role", ""], "a role has 1 to 127 bytes"),
        (["client", "plc1", "--role", "x" * 128], "a role has 1 to 127 bytes"),
        (["server", "--host", "ümlaut.example"], "--host"),
        (["client", "plc1", "--dir", "nowhere"], "nowhere: no authority here (ca.pem); make one: gateway certs init"),
        (["renew", "ca"], "an authority is not renewed"),
        (["renew", "nobody"], "nobody.pem: cannot read it: No such file"),
        (["init", "file/certs"], "file/certs: cannot make the folder"),
    ],
    ids=lambda value: " ".join(value)[:30] if isinstance(value, list) else None,
)
def test_mistakes_are_told(plant: Folder, capsys: pytest.CaptureFixture[str], argv: list[str], said: str) -> None:
    Path("file").write_text("")
    before = set(plant.path.iterdir())
    assert main(["certs", *argv]) == 2
    assert said in capsys.readouterr().err
    assert set(plant.path.iterdir()) == before


@pytest.mark.parametrize("name", ["ca.pem", "ca.key"])
def test_a_damaged_authority_is_told(plant: Folder, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (plant.path / name).write_text("-----BEGIN NONSENSE-----\n")
    assert main(["certs", "client", "plc1"]) == 2
    assert name in capsys.readouterr().err


@pytest.mark.parametrize("days", ["0", "-1", "36501", "x"])
def test_days_have_limits(plant: Folder, days: str) -> None:
    with pytest.raises(SystemExit):
        main(["certs", "client", "plc1", "--days", days])


def test_a_certificate_begins_a_little_earlier_for_slow_clocks(plant: Folder) -> None:
    begin = plant.certificate("ca").not_valid_before_utc
    assert timedelta(minutes=59) < datetime.now(UTC) - begin < timedelta(minutes=75)


# The role's bytes.


@given(
    st.text(min_size=1, max_size=40).filter(lambda text: len(text.encode("utf-8", "replace")) <= roles.MAX_ROLE_BYTES)
)
def test_roles_come_back(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError:
        return
    assert roles.decode_role(roles.role_extension(text).value) == text


@given(st.binary(max_size=160))
def test_any_bytes_are_a_role_or_none(der: bytes) -> None:
    role = roles.decode_role(der)
    assert role is None or roles.role_extension(role).value == der


@pytest.mark.parametrize(
    "der",
    [
        b"",
        b"\x0c\x00",  # empty
        b"\x13\x06viewer",  # a PrintableString
        b"\x0c\x06viewer\x00",  # something after it
        b"\x0c\x07viewer",  # cut off
        b"\x0c\x81\x06viewer",  # the long form of a length
        b"\x0c\x02\xff\xff",  # no UTF-8
        b"viewer",
    ],
)
def test_what_is_no_role(der: bytes) -> None:
    assert roles.decode_role(der) is None


FULL = """
import resource, sys
from gateway.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
sys.exit(main(["certs", "init", sys.argv[1]]))
"""


@pytest.mark.one_interpreter
def test_a_full_disk_leaves_no_half_key_behind(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    done = subprocess.run([sys.executable, "-c", FULL, folder], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"{folder / 'ca.key'}: cannot write it: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(folder.iterdir()) == []
    assert main(["certs", "init", str(folder)]) == 0
