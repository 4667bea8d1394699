"""Compile the vision kernels, where there is a C compiler: `python -m gateway.vision.compiled.build`.

All C files below `gateway/vision` become one library.

Without it everything works and gives the same results, slower. Standard library only: the package's build runs this
file before anything is installed.
"""

import os
import runpy
import shlex
import shutil
import subprocess
import sys
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCES = tuple(sorted(HERE.parent.rglob("*.[ch]")))
NUMBERS = (HERE / "sizes.py", HERE.parent / "detect" / "robust" / "constants.py")
UNITS = tuple(source for source in SOURCES if source.suffix == ".c")
LIBRARY = HERE / "_kernels.so"
# A sum has one order, and a product is rounded before it is added to: the same bits from every compiler and processor.
EXACT = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# No -Werror: what a later compiler warns of must not cost anybody the kernels. The tests have it.
FLAGS = ("-O3", "-std=c11", *EXACT, "-shared", "-fPIC", "-Wall", "-Wextra", f"-I{HERE}")
TIMEOUT_S = 300.0


def source_sum() -> int:
    """CRC-32 of the sources and numbers; the library carries the one it was built from."""
    return zlib.crc32(b"".join([*(source.read_bytes() for source in SOURCES), *map(str.encode, numbers())]))


def numbers() -> tuple[str, ...]:
    """The compiler's definitions of what C and NumPy share, so that it stands once."""
    shared = (item for file in NUMBERS for item in runpy.run_path(str(file)).items())
    return tuple(f"-D{name}={value!r}" for name, value in shared if name.isupper())


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
    command = [
        *words,
        *FLAGS,
        *numbers(),
        f"-DGATEWAY_SOURCE={source_sum()}u",
        "-o",
        str(fresh),
        *map(str, UNITS),
        "-lm",
    ]
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
        sys.exit(f"the vision kernels were not built: {why}")
    print("the vision kernels are built")
