"""Install the version that lies beside this file: /opt/loading-gateway/versions/VERSION, a virtual environment.

Without a network, with a Python of the machine. The version that runs goes on running: `/opt/loading-gateway/current`
is set only where there is none, or where what it names can't start any more (the machine's Python was replaced).
Interrupted at any moment, it leaves an installation that runs, and starts again from the beginning.

Prints `made` where it made the environment, `replaced` where that was the one `current` names, `switched` where it set
`current`; what goes wrong on stderr, and ends with 1. Standard library only.
"""

import argparse
import ctypes
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
AT_FDCWD = -100
RENAME_EXCHANGE = 2
REJECTED = "rejected"  # gateway/update writes it
# They are compiled, so they fail where the machine or its Python is not what the wheels are for.
IMPORTED = "import cryptography, cv2, gateway, numpy, pydantic, uvloop"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--into", metavar="FOLDER", type=Path, default=Path("/opt/loading-gateway"))
    args = parser.parse_args()
    os.umask(0o022)  # the service's user reads it, whatever root's habit is
    about = json.loads((HERE / "wheelhouse.json").read_text())
    if is_rejected(args.into, about["version"]):
        print(
            f"loading-gateway: version {about['version']} was tried by `gateway update` and not taken, so it is not "
            f"made. `gateway update` tries it again; without {args.into}/{REJECTED} it is made as any other",
            file=sys.stderr,
        )
        return 0
    python = suitable_python(about["pythons"])
    wanted = {
        "version": about["version"],
        "python": python,
        "requirements": hashlib.sha256((HERE / "requirements.txt").read_bytes()).hexdigest(),
    }
    target = args.into / "versions" / about["version"]
    current = args.into / "current"
    if installed(target) != wanted or not runs(target):
        replaced = target.exists() and current.resolve() == target.resolve()
        make(target, wanted)
        print("made")
        if replaced:
            print("replaced")
    if not runs(current):
        switch(current, target)
        print("switched")
    return 0


def is_rejected(into: Path, version: str) -> bool:
    """dpkg runs this again with each new Python. A version that an update did not take must not come back by that."""
    try:
        return (into / REJECTED).read_text().strip() == version
    except OSError:
        return False


def suitable_python(versions: list[str]) -> str:
    """The interpreter to use, by its version's own name (/usr/bin/python3.11): it stays until that package goes."""
    found = []
    for candidate in ("/usr/bin/python3", *(f"/usr/bin/python{version}" for version in reversed(versions))):
        code = "import sys, venv; print('%d.%d' % sys.version_info[:2], sys.executable)"
        if not Path(candidate).exists():
            continue
        done = subprocess.run([candidate, "-I", "-c", code], capture_output=True, text=True, timeout=60, check=False)
        if done.returncode:
            found.append(f"{candidate} without its module venv")
            continue
        version, executable = done.stdout.split()
        if version in versions:
            return os.path.realpath(executable)
        found.append(f"{candidate} is {version}")
    sys.exit(
        f"loading-gateway: needs Python {', '.join(versions[:-1])} or {versions[-1]} with its standard library "
        f"(apt-get install python3); found: {', '.join(found) or 'none in /usr/bin'}"
    )


def installed(target: Path) -> object:
    """What `make` wrote at its end; None for anything else."""
    try:
        return json.loads((target / "installed.json").read_text())
    except (OSError, ValueError):
        return None


def runs(environment: Path) -> bool:
    """Whether its Python starts and finds the gateway."""
    command = [str(environment / "bin/python"), "-I", "-c", "import gateway"]
    try:
        return subprocess.run(command, capture_output=True, timeout=120, check=False).returncode == 0
    except OSError:
        return False


def make(target: Path, wanted: dict[str, str]) -> None:
    """The environment, made beside its place and moved there when it is complete and was tried."""
    scratch = target.with_name(f".{target.name}.new")
    shutil.rmtree(scratch, ignore_errors=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    run(wanted["python"], "-I", "-m", "venv", "--without-pip", str(scratch))
    python = str(scratch / "bin/python")
    (pip,) = (HERE / "wheels").glob("pip-*.whl")
    run(
        *(python, "-I", f"{pip}/pip", "--isolated", "--disable-pip-version-check", "--no-input", "install", "--quiet"),
        *("--no-index", "--no-cache-dir", "--only-binary=:all:", "--require-hashes", "--root-user-action=ignore"),
        *("--find-links", str(HERE / "wheels"), "--requirement", str(HERE / "requirements.txt")),
    )
    run(python, "-I", "-c", IMPORTED)
    for path in (scratch / "pyvenv.cfg", *(scratch / "bin").iterdir()):  # they name the place they were made in
        if not path.is_symlink():
            path.write_bytes(path.read_bytes().replace(bytes(scratch), bytes(target)))
    (scratch / "installed.json").write_text(json.dumps(wanted) + "\n")
    os.sync()  # the files before their names: after a power cut the place holds all of it, or what was there before
    put(scratch, target)
    sync_folder(target.parent)
    shutil.rmtree(scratch, ignore_errors=True)


def put(scratch: Path, target: Path) -> None:
    """Move `scratch` to `target`; where something is there, both change places in one step."""
    if not target.exists():
        scratch.rename(target)
        return
    try:
        exchange = ctypes.CDLL(None, use_errno=True).renameat2
        failed = exchange(AT_FDCWD, bytes(scratch), AT_FDCWD, bytes(target), RENAME_EXCHANGE)
    except AttributeError:  # a C library without it
        failed = -1
    if failed:  # a file system without it: in two steps
        old = target.with_name(f".{target.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        target.rename(old)
        scratch.rename(target)
        shutil.rmtree(old, ignore_errors=True)


def switch(current: Path, target: Path) -> None:
    fresh = current.with_name(".current.new")
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(Path("versions") / target.name)
    fresh.replace(current)
    sync_folder(current.parent)


def sync_folder(folder: Path) -> None:
    """A new name in it survives a power cut."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def run(*command: str) -> None:
    environment = {"PATH": os.defpath, "LANG": "C.UTF-8", "PIP_CONFIG_FILE": os.devnull, "HOME": "/nonexistent"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr or done.stdout).strip()[-2000:]
        sys.exit(f"loading-gateway: {' '.join(command)} ended with {done.returncode}: {said}")


if __name__ == "__main__":
    sys.exit(main())
