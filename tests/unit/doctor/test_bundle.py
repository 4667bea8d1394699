"""The bundle for support has what was asked for, and none of the passwords: every byte of it is searched."""

import os
import zipfile
import zlib
from pathlib import Path

import pytest

from gateway.cli.main import main
from gateway.config import load, parse
from gateway.doctor import bundle
from gateway.records.segment import Block, BlockKind, blocks
from gateway.web.ipc.devices import Finding, Verdict
from tests.recorded_bay import Recorded

SECRETS = (
    "In-The-Url",
    "In A File",
    "In-The-Environment",
    "c2FsdHNhbHQ",
    "Of%20The%20Camera",
    "Of The Camera",
    "Db-Pw",
)
LOGGED = "DESCRIBE rtsp://u:Of%20The%20Camera@h failed; postgresql://u@h?sslpassword=Db-Pw"
HASH = "$argon2id$v=19$m=19456,t=2,p=1$c2FsdHNhbHQ$q6urq6urq6urq6urq6urq6urq6urq6urq6urq6urq6s"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "pw").write_text("In A File\n")
    monkeypatch.setenv("DB_PASSWORD", "In-The-Environment")
    path = tmp_path / "gateway.toml"
    path.write_text(f"""
site = "site"
state_dir = "{tmp_path}"
[records]
folder = "{tmp_path}"
[mqtt]
urls = ["mqtt://127.0.0.1:1", "mqtt://127.0.0.1:2"]
username = "u"
password_file = "{tmp_path}/pw"
[camera]
url = "rtsp://u:Of%20The%20Camera@127.0.0.1/live"
[hmi]
enabled = true
users = [{{ name = "ann", role = "viewer", password_hash = "{HASH}" }}]
[sinks.postgresql]
url = "postgresql://u@127.0.0.1:3/db?sslpassword=Db-Pw"
password_env = "DB_PASSWORD"
""")
    monkeypatch.setattr(bundle, "findings", lambda *_: iter(SAID))
    monkeypatch.setattr(bundle, "_journal", LOGGED.encode)
    return path


SAID = [Finding("camera", "bay1", Verdict.FAULT, "open it", "401 for Of The Camera and In A File", "check it")]


def parts(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def everything(data: bytes) -> bytes:
    """With what is compressed in a recording."""
    found = [b for b in blocks(data) if isinstance(b, Block)]
    return data + b"".join(zlib.decompress(b.payload) for b in found if b.kind == BlockKind.RECORDS)


def test_it_has_all_parts_and_no_password(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded = Recorded(tmp_path)
    for n in range(6):
        recorded.write(n * 10**9)
    out = tmp_path / "case.zip"
    assert main(["bundle", str(file), "--out", str(out)]) == 0
    found = parts(out)
    kept = sorted(name for name in found if name.startswith("records/"))
    assert [name.partition("bay1/")[2][:8] for name in kept] == ["00000003", "00000004", "00000005", "00000006"]
    assert set(found) - set(kept) == {"settings.txt", "doctor.jsonl", "machine.json", "journal.txt", "contents.txt"}
    assert b'camera.url = "rtsp://***@127.0.0.1/live"' in found["settings.txt"]
    assert b"401 for *** and ***" in found["doctor.jsonl"]
    assert found["journal.txt"] == b"DESCRIBE rtsp://u:***@h failed; postgresql://u@h?sslpassword=***"
    for name, data in found.items():
        for secret in SECRETS:
            assert secret.encode() not in everything(data), name
    assert out.stat().st_mode & 0o077 == 0
    assert "Look into it" in capsys.readouterr().out


def test_a_recording_of_before_with_a_password_in_it_is_left_out(file: Path, tmp_path: Path) -> None:
    bay = tmp_path / "site.gateway" / "bay1"
    bay.mkdir(parents=True)
    (bay / "00000001-20261123T031500Z.seg").write_bytes(b'LGRECORD1\n{"url": "rtsp://u:Of%20The%20Camera@h"}')
    lines = list(bundle.write(load(file), tmp_path / "case.zip", 1, pictures=False))
    assert lines[-1] == "records/bay1/00000001-20261123T031500Z.seg: left out, its head has a password"
    assert not any(name.startswith("records/") for name in parts(tmp_path / "case.zip"))


def test_pictures_only_where_they_are_asked_for(file: Path, tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.picture(10**9, 1, "stop")
    for asked, count in ((False, 0), (True, 1)):
        list(bundle.write(load(file), tmp_path / "case.zip", 1, pictures=asked))
        assert len([name for name in parts(tmp_path / "case.zip") if name.endswith(".pictures")]) == count


def test_every_password_of_a_configuration_is_known(file: Path) -> None:
    known = set(bundle.secrets_of(load(file)))
    assert known == {
        b"In A File",
        b"In-The-Environment",
        b"Of%20The%20Camera",
        b"Of The Camera",
        HASH.encode(),
        b"Db-Pw",
    }


@pytest.mark.parametrize(
    ("settings", "known"),
    [
        ({"mqtt": {"url": "mqtt://u:In-The-Url@b"}}, {b"In-The-Url"}),
        ({"camera": {"url": "rtsp://h/live?user=admin&password=ge%40heim"}}, {b"ge%40heim", b"ge@heim"}),
        ({"camera": {"url": "rtsp://h/live?PWD=geheim+1"}}, {b"geheim+1", b"geheim 1"}),
        ({"camera": {"url": "rtsp://h/user=a_password=geheim_channel=1_stream=0.sdp"}}, {b"geheim"}),
        # So short a value occurs anywhere, and this one is no password at all.
        ({"camera": {"url": "rtsp://h/live?keyframe=1&x=2"}}, {b"keyframe=1"}),
        ({"sinks": {"x": {"token": "T0ken", "header": {"api_secret": "S3cret"}}}}, {b"T0ken", b"S3cret"}),
        ({"sinks": {"x": {"clients": [{"password": "Of-One"}]}}}, {b"Of-One"}),
        ({"sinks": {"x": {"token_file": "/etc/t", "passive": True, "token": ""}}}, set()),
    ],
)
def test_passwords_of_addresses_and_of_sinks_are_known(settings: dict[str, object], known: set[bytes]) -> None:
    assert set(bundle.secrets_of(parse(settings, source=""))) == known


def test_only_recordings_are_read_whatever_the_service_has_put_there(file: Path, tmp_path: Path) -> None:
    """It may be root that runs this, and the folder is the service's."""
    bay = tmp_path / "site.gateway" / "bay1"
    bay.mkdir(parents=True)
    (tmp_path / "of-root").write_bytes(b"root's alone")
    (bay / "00000001-20261123T031500Z.seg").symlink_to(tmp_path / "of-root")
    os.mkfifo(bay / "00000002-20261123T031500Z.seg")
    out = tmp_path / "case.zip"
    lines = list(bundle.write(load(file), out, 1, pictures=False))
    assert not any(name.startswith("records/") for name in parts(out))
    assert [line.partition(": ")[2] for line in lines[-2:]] == [
        "left out, Too many levels of symbolic links",
        "left out, not a regular file",
    ]


def test_a_link_in_the_place_of_the_bundle_is_not_followed(file: Path, tmp_path: Path) -> None:
    """Its name can be guessed, and the folder may be everybody's."""
    victim = tmp_path / "victim"
    victim.write_bytes(b"as it was")
    for name in ("case.zip", "case.zip.new"):
        (tmp_path / name).symlink_to(victim)
    list(bundle.write(load(file), tmp_path / "case.zip", 1, pictures=False))
    assert victim.read_bytes() == b"as it was"
    assert not (tmp_path / "case.zip").is_symlink()
    assert "contents.txt" in parts(tmp_path / "case.zip")


def test_a_link_that_is_put_there_just_then_is_not_followed(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim, fresh = tmp_path / "victim", tmp_path / "case.zip.new"
    victim.write_bytes(b"as it was")
    real = Path.unlink

    def unlink(self: Path, missing_ok: bool = False) -> None:
        real(self, missing_ok=missing_ok)
        if self == fresh:
            fresh.symlink_to(victim)

    monkeypatch.setattr(Path, "unlink", unlink)
    with pytest.raises(FileExistsError):
        list(bundle.write(load(file), tmp_path / "case.zip", 1, pictures=False))
    assert victim.read_bytes() == b"as it was"


def test_segments_of_the_newest_incidents_and_of_those_that_somebody_keeps_are_in_it(
    file: Path, tmp_path: Path
) -> None:
    recorded = Recorded(tmp_path)
    for n in range(1, 9):  # numbers 1 to 16: a segment, and pictures of an incident in it
        recorded.write(n * 10**9)
        recorded.picture(n * 10**9, n, "stop")
    for n in range(9, 15):
        recorded.write(n * 10**9)
    kept = next(recorded.path.glob("00000004-*.pictures"))
    kept.with_name(f"{kept.name}.pin").touch()
    list(bundle.write(load(file), tmp_path / "case.zip", 1, pictures=True))
    found = [name.partition("bay1/")[2] for name in parts(tmp_path / "case.zip") if name.startswith("records/")]
    assert sorted(int(name[:8]) for name in found if name.endswith(".seg")) == [3, 7, 9, 11, 13, 15, 19, 20, 21, 22]
    assert sorted(int(name[:8]) for name in found if name.endswith(".pictures")) == [4, 8, 10, 12, 14, 16]


def test_a_place_that_cannot_be_written_is_an_error_and_leaves_nothing(file: Path, tmp_path: Path) -> None:
    assert main(["bundle", str(file), "--out", str(tmp_path / "none" / "case.zip")]) == 2
    assert not (tmp_path / "none").exists()
