"""The file on the disk: replaced completely, with mode and owner, through symlinks; or left exactly as it was."""

import os
import stat
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.web.host import config_file
from gateway.web.ipc.messages import ChangedOnDiskError


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_bytes("\ufeffsite = 'ä'\r\n".encode())
    path.chmod(0o640)
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_new_text_is_there_with_the_old_mode_and_the_old_text_beside_it(plant: Path) -> None:
    loaded = config_file.load(plant)

    backup = config_file.save(loaded, loaded.text + "# more\n")

    assert plant.read_bytes() == "\ufeffsite = 'ä'\r\n# more\n".encode()
    assert stat.S_IMODE(plant.stat().st_mode) == 0o640
    assert backup.read_bytes() == "\ufeffsite = 'ä'\r\n".encode()
    assert stat.S_IMODE(backup.stat().st_mode) == 0o640
    assert names(plant.parent) == ["plant.toml", "plant.toml.previous"]


def test_a_second_save_needs_a_second_look(plant: Path) -> None:
    loaded = config_file.load(plant)
    config_file.save(loaded, "a = 1\n")

    with pytest.raises(ChangedOnDiskError, match=r"plant\.toml: was changed elsewhere"):
        config_file.save(loaded, "b = 1\n")

    assert plant.read_text() == "a = 1\n"
    assert names(plant.parent) == ["plant.toml", "plant.toml.previous"]
    config_file.save(config_file.load(plant), "b = 1\n")
    assert (plant.parent / "plant.toml.previous").read_text() == "a = 1\n"


def test_a_symlink_is_followed_and_stays_one(plant: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "etc"
    elsewhere.mkdir()
    link = elsewhere / "gateway.toml"
    link.symlink_to(plant)

    backup = config_file.save(config_file.load(link), "new = 1\n")

    assert link.is_symlink()
    assert plant.read_text() == "new = 1\n"
    assert backup == tmp_path / "plant.toml.previous"
    assert names(elsewhere) == ["gateway.toml"]


def test_the_owner_is_kept(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[int, int]] = []
    real = Path.stat

    class Theirs:
        """What the file system would say of a file of user 77, group 88."""

        def __init__(self, info: os.stat_result) -> None:
            self.st_mode, self.st_uid, self.st_gid = info.st_mode, 77, 88

    monkeypatch.setattr(Path, "stat", lambda self, **more: Theirs(real(self, **more)))
    monkeypatch.setattr(os, "geteuid", lambda: 77)
    monkeypatch.setattr(os, "fchown", lambda handle, uid, gid: given.append((uid, gid)))
    config_file.save(config_file.load(plant), "x = 1\n")

    assert given == [(77, 88), (77, 88)]  # the copy and the new file


def test_another_user_s_file_is_not_replaced(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: plant.stat().st_uid + 1)

    with pytest.raises(ConfigError, match="belongs to another user"):
        config_file.save(config_file.load(plant), "x = 1\n")

    assert names(plant.parent) == ["plant.toml"]


def test_a_read_only_file_is_reported_before_anything_is_written(plant: Path) -> None:
    loaded = config_file.load(plant)
    plant.chmod(0o440)

    assert config_file.why_not_writable(plant) == f"{plant}: is read-only for the gateway"
    with pytest.raises(ConfigError, match="is read-only for the gateway"):
        config_file.save(loaded, "x = 1\n")

    assert names(plant.parent) == ["plant.toml"]


def test_a_read_only_folder_is_reported(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != plant.parent)

    assert "the gateway may not write in this folder" in config_file.why_not_writable(plant)


def test_without_a_file_export_is_offered(plant: Path) -> None:
    assert "export a profile" in config_file.why_not_writable(None)
    assert "No such file" in config_file.why_not_writable(plant.parent / "gone.toml")
    assert "not a regular file" in config_file.why_not_writable(plant.parent)
    assert config_file.why_not_writable(plant) == ""


@pytest.mark.parametrize(
    ("number", "expected"),
    [(16, "mount its folder instead"), (28, "the disk is full"), (30, "mounted read-only"), (5, "Input")],
)
def test_a_failing_disk_leaves_the_file_and_no_litter(
    plant: Path, monkeypatch: pytest.MonkeyPatch, number: int, expected: str
) -> None:
    loaded = config_file.load(plant)

    def fails(self: Path, target: Path) -> Path:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", fails)
        with pytest.raises(ConfigError, match=rf"plant\.toml: cannot be written: .*{expected}"):
            config_file.save(loaded, "x = 1\n")

    assert config_file.load(plant) == loaded
    assert names(plant.parent) == ["plant.toml"]


def test_what_is_no_text_is_refused(plant: Path) -> None:
    plant.write_bytes(b"\xff\xfe")

    with pytest.raises(ConfigError, match=r"plant\.toml: is not UTF-8"):
        config_file.load(plant)
    with pytest.raises(ConfigError, match=r"gone\.toml: cannot be read: No such file"):
        config_file.load(plant.parent / "gone.toml")
    plant.write_bytes(b"#" * (4 * 1024 * 1024 + 1))
    with pytest.raises(ConfigError, match="larger than 4 MiB"):
        config_file.load(plant)
