"""The bundle for support has what was asked for, and none of the passwords: every byte of it is searched."""

import zipfile
import zlib
from pathlib import Path

import pytest

from gateway.cli.main import main
from gateway.config import GatewayConfig, load
from gateway.doctor import bundle
from gateway.doctor.finding import Finding, Verdict
from gateway.records.segment import Block, BlockKind, blocks
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
url = "postgresql://u@127.0.0.1:3/db"
password_env = "DB_PASSWORD"
""")
    monkeypatch.setattr(bundle, "findings", lambda *_: iter(SAID))
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
    assert known == {b"In A File", b"In-The-Environment", b"Of%20The%20Camera", b"Of The Camera", HASH.encode()}
    assert set(bundle.secrets_of(GatewayConfig.model_validate({"mqtt": {"url": "mqtt://u:In-The-Url@b"}}))) == {
        b"In-The-Url"
    }


def test_a_place_that_cannot_be_written_is_an_error_and_leaves_nothing(file: Path, tmp_path: Path) -> None:
    assert main(["bundle", str(file), "--out", str(tmp_path / "none" / "case.zip")]) == 2
    assert not (tmp_path / "none").exists()
