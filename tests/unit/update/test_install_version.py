"""What the package's installation does with names and marks; a real one is tests/e2e/test_package.py."""

import importlib.util
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from gateway.update.machine import InstallPaths

SOURCE = Path(__file__).parents[3] / "packaging/install_version.py"


@pytest.fixture
def installer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """As it lies in the unpacked package of version 2.0, below another root."""
    spec = importlib.util.spec_from_file_location("install_version", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    share = tmp_path / "share"
    share.mkdir()
    (share / "wheelhouse.json").write_text(json.dumps({"version": "2.0", "pythons": ["3.11"]}))
    (share / "requirements.txt").write_text("")
    paths = InstallPaths(tmp_path)
    paths.versions.mkdir(parents=True)
    monkeypatch.setattr(module, "HERE", share)
    monkeypatch.setattr(module, "suitable_python", lambda _: "/usr/bin/python3.11")
    monkeypatch.setattr(module, "runs", lambda _: False)
    monkeypatch.setattr(sys, "argv", ["install_version.py", "--into", str(paths.versions.parent)])
    umask = os.umask(0)
    yield module
    os.umask(umask)


@pytest.mark.parametrize("rejected", ["2.0\n", "1.9\n", None])
def test_a_version_that_an_update_did_not_take_is_not_made(
    installer: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    rejected: str | None,
) -> None:
    """Also where the version in use can't start any more, since its Python is gone."""
    monkeypatch.setattr(installer, "make", lambda target, _: target.mkdir())
    paths = InstallPaths(tmp_path)
    if rejected is not None:
        paths.rejected.write_text(rejected)
    assert installer.main() == 0
    out, err = capsys.readouterr()
    if rejected == "2.0\n":
        assert (out, os.path.lexists(paths.current), list(paths.versions.iterdir())) == ("", False, [])
        assert "version 2.0 was tried by `gateway update` and not taken, so it is not made" in err
    else:
        assert (out, err) == ("made\nswitched\n", "")
        assert os.readlink(paths.current) == "versions/2.0"


def test_new_names_are_on_disk_when_it_goes_on(
    installer: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []

    def noted(name: str) -> None:
        real = getattr(Path, name)

        def renamed(self: Path, target: Path) -> Path:
            order.append(f"rename {Path(target).name}")
            moved: Path = real(self, target)
            return moved

        monkeypatch.setattr(Path, name, renamed)

    noted("replace")
    noted("rename")
    monkeypatch.setattr(os, "sync", lambda: order.append("all"))
    monkeypatch.setattr(os, "fsync", lambda fd: order.append(Path(os.readlink(f"/proc/self/fd/{fd}")).name))
    paths = InstallPaths(tmp_path)
    installer.switch(paths.current, paths.versions / "2.0")
    assert order == ["rename current", "loading-gateway"]
    order.clear()
    (tmp_path / "share/wheels").mkdir()
    (tmp_path / "share/wheels/pip-1-py3-none-any.whl").touch()
    made = paths.versions / ".2.0.new"

    def run(*_: str) -> None:
        """The programs that make the environment."""
        (made / "bin").mkdir(parents=True, exist_ok=True)
        (made / "pyvenv.cfg").touch()

    monkeypatch.setattr(installer, "run", run)
    installer.make(paths.versions / "2.0", {"python": "python3.11"})
    assert order == ["all", "rename 2.0", "versions"]
