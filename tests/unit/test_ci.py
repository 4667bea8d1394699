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
"""


def test_the_checks_are_the_commands_of_the_readme_in_the_environment_of_a_user(tmp_path: Path) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci" / "run")
    (tmp_path / "dev").write_text(DEV)
    (tmp_path / "dev").chmod(0o755)
    machine = {"PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": "/nowhere", "PYTHON_COLORS": "0"}
    done = subprocess.run(
        [tmp_path / ".ci" / "run"], env=os.environ | machine, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["./dev check", "./dev test", "./dev test --all"]
    documented = (ROOT / "README.md").read_text() + (ROOT / "CONTRIBUTING.md").read_text()
    for command in done.stdout.splitlines():
        assert re.search(rf"^{re.escape(command)}\s", documented, re.MULTILINE)
