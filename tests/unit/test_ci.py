"""What the checks run is what a user runs."""

import os
import re
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
DEV = """#!/usr/bin/env bash
echo "./dev $*"
env | grep ^PYTHON || true
[ -n "$CI" ] || echo "something may be left out"
"""


def test_the_checks_are_the_commands_of_the_readme_in_the_environment_of_a_user(tmp_path: Path) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci" / "run")
    (tmp_path / "dev").write_text(DEV)
    (tmp_path / "dev").chmod(0o755)
    machine = {"PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": "/nowhere", "PYTHON_COLORS": "0"}
    machine |= {"CI": ""}
    done = subprocess.run(
        [tmp_path / ".ci" / "run"], env=os.environ | machine, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["./dev check", "./dev test", "./dev test --all"]
    documented = (ROOT / "README.md").read_text() + (ROOT / "CONTRIBUTING.md").read_text()
    for command in done.stdout.splitlines():
        assert re.search(rf"^{re.escape(command)}\s", documented, re.MULTILINE)


def without_npm(ci: str) -> "subprocess.CompletedProcess[str]":
    """What `./dev` does where npm's packages can't be installed."""
    text = (ROOT / "dev").read_text()
    functions = [re.search(rf"^{name}\(\) \{{.*?\}}$", text, re.M | re.S) for name in ("say", "die", "npm_packages")]
    script = "\n".join(each[0] for each in functions if each)
    script += "\nnpm() { return 1; }\nif npm_packages nowhere 'the lint'; then echo linted; fi\necho the rest"
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        env=os.environ | {"CI": ci}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_without_npms_packages_a_user_is_told_what_is_left_out_and_the_rest_goes_on() -> None:
    done = without_npm("")
    assert (done.returncode, done.stdout) == (0, "the rest\n")
    assert "LEFT OUT" in done.stderr
    assert "the lint" in done.stderr


def test_without_npms_packages_a_build_machine_fails() -> None:
    done = without_npm("1")
    assert (done.returncode, done.stdout) == (1, "")
    assert "npm could not install what nowhere/package-lock.json lists" in done.stderr


def test_a_checkout_that_can_not_be_written_is_named(tmp_path: Path) -> None:
    """A file where the folder is to be: the rights of root would make any folder one that can be written."""
    shutil.copy(ROOT / "dev", tmp_path / "dev")
    (tmp_path / ".dev").touch()
    done = subprocess.run([tmp_path / "dev", "run"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith(f"dev: {tmp_path} can't be written by ")
