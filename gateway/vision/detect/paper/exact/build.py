"""Compile the kernel, where there is a C compiler: `python -m gateway.vision.detect.paper.exact.build`.

Without it everything works and gives the same results, slower. Standard library only: the package's build runs this
file before anything is installed.
"""

import os
import shlex
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

SOURCE = Path(__file__).with_name("kernel.c")
SOURCES = (SOURCE, *(SOURCE.with_name(name) for name in ("blur.h", "maybe.h", "morph.h", "red.h", "wide.h")))
LIBRARY = Path(__file__).with_name("_kernel.so")
FLAGS = ("-O3", "-std=c11", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror")
TIMEOUT_S = 120.0


def source_sum() -> int:
    """CRC-32 of the sources; the library carries the one it was built from."""
    return zlib.crc32(b"".join(source.read_bytes() for source in SOURCES))


def compiler() -> list[str] | None:
    """`CC` of the environment, as make takes it, or what is on the path."""
    named = shlex.split(os.environ.get("CC", ""))
    for words in (named, ["cc"], ["gcc"], ["clang"]):
        if words and shutil.which(words[0]):
            return words
    return None


def build(library: Path = LIBRARY) -> str:
    """Write the library; "" when it exists, else the reason as text. Never raises for a compiler that fails."""
    words = compiler()
    if words is None:
        return "there is no C compiler (cc, gcc or clang)"
    fresh = library.with_suffix(f".{os.getpid()}.tmp")
    command = [*words, *FLAGS, f"-DGATEWAY_SOURCE={source_sum()}u", "-o", str(fresh), str(SOURCE)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        if done.returncode:
            return f"{words[0]} failed: {done.stderr.strip()[-400:]}"
        fresh.replace(library)  # complete or not at all: a process may be loading the old one
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{words[0]} failed: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return ""


if __name__ == "__main__":
    if why := build():
        sys.exit(f"the kernel was not built: {why}")
    print("the kernel is built")
