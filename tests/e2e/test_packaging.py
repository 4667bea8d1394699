"""The unit, as systemd itself judges it."""

import subprocess
from pathlib import Path

UNIT = Path(__file__).parents[2] / "packaging/systemd/loading-gateway.service"


def test_systemd_takes_every_line_and_finds_it_little_exposed() -> None:
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=20", str(UNIT)]
    judged = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert judged.returncode == 0, judged.stdout[-200:] + judged.stderr
    assert "Unknown" not in judged.stderr
    assert "Overall exposure level for loading-gateway.service: 1.9 OK" in judged.stdout
