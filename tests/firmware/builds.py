"""Make, one at a time: test processes beside each other build into the same folder."""

import fcntl
import os
import subprocess
from pathlib import Path

from gateway.sim.emulator import FIRMWARE

PACKAGES = "make gcc gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev"


def make(*targets: str, folder: Path = FIRMWARE) -> str:
    """Run the Makefile of `folder`; what it printed. Waits for another process's make. Fails with its errors."""
    directory = os.open(FIRMWARE, os.O_RDONLY)
    try:
        fcntl.flock(directory, fcntl.LOCK_EX)
        done = subprocess.run(["make", "-C", str(folder), *targets], capture_output=True, text=True, check=False)
    finally:
        os.close(directory)
    assert done.returncode == 0, f"{done.stderr[-3000:]}\napt-get install {PACKAGES}"
    return done.stdout
