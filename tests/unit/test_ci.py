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


def shell(script: str, *names: str, ci: str = "") -> "subprocess.CompletedProcess[str]":
    """A script of functions of `./dev`."""
    text = (ROOT / "dev").read_text()
    functions = [
        re.search(rf"^{name}\(\) \{{(?:[^\n]*\}}|.*?^\}})$", text, re.M | re.S) for name in ("say", "die", *names)
    ]
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join([*(each[0] for each in functions if each), script])],
        env=os.environ | {"CI": ci}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def without_npm(ci: str) -> "subprocess.CompletedProcess[str]":
    """What `./dev` does where npm's packages can't be installed."""
    script = "npm() { return 1; }\nif npm_packages nowhere 'the lint'; then echo linted; fi\necho the rest"
    return shell(script, "npm_packages", ci=ci)


PARTS = """
TITLES=() RUNNING=() FAILED=() LOGS=
begin 'the first' bash -c 'echo of the first; exit 1'
begin 'the second' echo of the second
finish 0
begin 'the third' bash -c 'echo of the third >&2; exit 2'
finish
report
echo never
"""


def test_every_part_of_a_test_run_runs_and_those_that_failed_are_listed_at_the_end() -> None:
    done = shell(PARTS, "begin", "timed", "finish", "report")
    assert done.returncode == 1
    shown = [re.sub(r"[0-9]+", "N", line) for line in done.stdout.splitlines()]
    assert shown == [
        "of the first", "of the second", "of the third",
        *(f"the {which:<28} N s, with N + N s of a processor" for which in ("first", "second", "third")),
    ]  # fmt: skip
    assert done.stderr.splitlines()[-1] == "dev: failed: the first, the third"


def test_a_test_run_without_a_failure_passes() -> None:
    done = shell(PARTS.replace("exit 1", "exit 0").replace("exit 2", "exit 0"), "begin", "timed", "finish", "report")
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "never")


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
