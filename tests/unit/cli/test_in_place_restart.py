"""A program that is started again in its own place: after its last work, with its arguments and what it had removed."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """\
import atexit, os, sys
from gateway.cli.in_place_restart import InPlaceRestart

restart = InPlaceRestart()
atexit.register(lambda: print("the last work", flush=True))
given = os.environ.pop("GIVEN")
print(os.getpid(), sys.argv[1:], given, flush=True)
if given == "first":
    restart.request({"GIVEN": "second"})
sys.exit(7)
"""


def test_the_same_process_starts_again_once_its_last_work_is_done(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, str(script), "--port", "5 0"],
        env={"GIVEN": "first", "PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    lines = done.stdout.splitlines()
    pid = lines[0].split()[0]
    assert lines == [
        f"{pid} ['--port', '5 0'] first", "the last work", f"{pid} ['--port', '5 0'] second", "the last work"
    ], done.stderr  # fmt: skip
    assert done.returncode == 7
