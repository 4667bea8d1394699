"""The wheelhouse: every wheel that an installation of the gateway needs, as uv.lock states them, for one architecture.

A folder with `wheels/`, `requirements.txt` (with hashes), `wheelhouse.json`, `sbom.cdx.json` and `install_version.py`,
which makes an installation of it without a network. The Debian package carries it, and an archive of its own.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import urllib.request
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sbom
from packaging.markers import Marker
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

ROOT = Path(__file__).resolve().parents[1]
UV = ROOT / ".dev/uv/bin/uv"
CACHE = ROOT / ".dev/wheels"
PROJECT = "plc-loading-gateway"
EXTRAS = ("mcap", "opcua", "postgresql")
KERNEL = "gateway/vision/compiled/_kernels.so"
FIRMWARE = "gateway/ranger/hcsr04/ranger.hex"
GLIBC = (2, 36)  # Debian 12's; wheels for a newer one are not taken
TIMEOUT_S = 300.0


class PackageError(Exception):
    """Something that who builds the package can mend; the text says what."""


@dataclass(frozen=True)
class Architecture:
    """Debian's name, the machine's name in wheels, the compiler of the kernels, the machine's number in ELF files."""

    name: str
    machine: str
    compiler: str
    elf_machine: int


ARCHITECTURES = {
    "amd64": Architecture("amd64", "x86_64", "x86_64-linux-gnu-gcc", 62),
    "arm64": Architecture("arm64", "aarch64", "aarch64-linux-gnu-gcc", 183),
}


def write(folder: Path, architecture: Architecture, pythons: list[str], version: str, epoch: int) -> None:
    """Write the wheelhouse into `folder`, a new one. Raises PackageError."""
    wheels = folder / "wheels"
    wheels.mkdir(parents=True)
    own = project_wheel(wheels, architecture, version, epoch)
    lines = [
        "# pip install --no-index --find-links wheels --require-hashes -r requirements.txt",
        f"{PROJECT}=={version} \\\n    --hash=sha256:{sha256(own)}",
    ]
    arguments = [f"--extra={extra}" for extra in EXTRAS]
    for package in locked("--no-dev", "--no-emit-project", *arguments):
        hashes = []
        for wheel in {w["url"]: w for w in chosen(package, architecture, pythons)}.values():
            shutil.copy(fetched(wheel), wheels)
            hashes.append(wheel["hashes"]["sha256"])
        if hashes:
            marker = f" ; {package['marker']}" if "marker" in package else ""
            stated = [f"    --hash=sha256:{one}" for one in sorted(hashes)]
            lines.append(" \\\n".join([f"{package['name']}=={package['version']}{marker}", *stated]))
    (folder / "requirements.txt").write_text("\n".join(lines) + "\n")
    (pip,) = [package for package in locked("--only-group=package") if package["name"] == "pip"]
    (pip_wheel,) = {wheel["url"]: wheel for wheel in chosen(pip, architecture, pythons)}.values()
    shutil.copy(fetched(pip_wheel), wheels)
    about = {"version": version, "architecture": architecture.name, "pythons": pythons}
    (folder / "wheelhouse.json").write_text(json.dumps(about) + "\n")
    (folder / "sbom.cdx.json").write_text(sbom.document(list(wheels.glob("*.whl")), PROJECT, version))
    shutil.copy(ROOT / "packaging/install_version.py", folder)
    for path in sorted(folder.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
        os.utime(path, (epoch, epoch))


def archive(folder: Path, target: Path, epoch: int) -> None:
    """`folder` as a tar archive, the same bytes for the same files. Not compressed: wheels are, already."""

    def plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member.uid = member.gid = 0
        member.uname = member.gname = "root"
        member.mtime = epoch
        return member

    with tarfile.open(target, "w") as tar:
        tar.add(folder, target.name.removesuffix(".tar"), filter=plain)  # in the order of their names


def project_wheel(wheels: Path, architecture: Architecture, version: str, epoch: int) -> Path:
    """The gateway's own wheel with compiled kernels. Built in a copy: the checkout keeps the kernels it runs with."""
    if shutil.which(architecture.compiler) is None:
        package = f"{architecture.compiler.split('-')[0]}-linux-gnu".replace("_", "-")
        packages = f"gcc-{package} libc6-dev-{architecture.name}-cross"
        raise PackageError(f"{architecture.compiler} is missing; on Debian: apt-get install {packages}")
    copy = wheels.parent / "source"
    nothing_built = shutil.ignore_patterns("__pycache__", "*.so", "*.tmp")
    for name in ("gateway", "config", "docs"):
        shutil.copytree(ROOT / name, copy / name, ignore=nothing_built)
    shutil.copytree(ROOT / "firmware", copy / "firmware", ignore=shutil.ignore_patterns("build", "bench"))
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    project = (copy / "pyproject.toml").read_text()
    (copy / "pyproject.toml").write_text(re.sub(r'(?m)^version = ".*"$', f'version = "{version}"', project, count=1))
    environment = {
        **os.environ,
        "CC": architecture.compiler,
        "_PYTHON_HOST_PLATFORM": f"linux-{architecture.machine}",  # what sysconfig, and so the wheel's tag, names
        "SOURCE_DATE_EPOCH": str(epoch),
    }
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)]
    built = run(command, cwd=copy, env=environment)
    shutil.rmtree(copy)
    (wheel,) = wheels.glob("*.whl")
    try:
        kernel = zipfile.ZipFile(wheel).read(KERNEL)
    except KeyError:
        raise PackageError(f"{wheel.name} has no {KERNEL}: {(built.stdout + built.stderr).strip()}") from None
    if int.from_bytes(kernel[18:20], "little") != architecture.elf_machine:
        raise PackageError(f"{wheel.name}: {KERNEL} is for another machine than {architecture.machine}")
    if FIRMWARE not in zipfile.ZipFile(wheel).namelist():
        print(f"{wheel.name} has no firmware for the Arduino: {(built.stdout + built.stderr).strip()}", file=sys.stderr)
    return wheel


def locked(*arguments: str) -> list[dict[str, Any]]:
    """Packages of uv.lock with their wheels, as `uv export` selects them."""
    command = [str(UV), "export", "--frozen", "--quiet", "--format=pylock.toml", *arguments]
    packages: list[dict[str, Any]] = tomllib.loads(run(command, cwd=ROOT).stdout)["packages"]
    return packages


def chosen(package: dict[str, Any], architecture: Architecture, pythons: list[str]) -> Iterator[dict[str, Any]]:
    """The best wheel of a package for each version of Python; none where its marker excludes it."""
    for python in pythons:
        environment = {
            "python_version": python,
            "python_full_version": f"{python}.0",
            "implementation_name": "cpython",
            "platform_python_implementation": "CPython",
            "platform_machine": architecture.machine,
            "sys_platform": "linux",
            "platform_system": "Linux",
            "os_name": "posix",
        }
        if "marker" in package and not Marker(package["marker"]).evaluate(environment):
            continue
        wheels = [
            (parse_wheel_filename(wheel["url"].rsplit("/", 1)[1])[3], wheel) for wheel in package.get("wheels", [])
        ]
        for tag in tags(python, architecture.machine):
            if fitting := [wheel for its_tags, wheel in wheels if tag in its_tags]:
                yield fitting[0]
                break
        else:
            raise PackageError(f"{package['name']} {package['version']}: no wheel for Python {python}, {architecture}")


def tags(python: str, machine: str) -> Iterator[Tag]:
    """What runs on such a machine, the best first."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in range(GLIBC[1], 4, -1)]
    platforms += [f"manylinux2014_{machine}", f"manylinux2010_{machine}", f"manylinux1_{machine}", f"linux_{machine}"]
    major, minor = python.split(".")
    name = f"cp{major}{minor}"
    yield from cpython_tags((int(major), int(minor)), [name], platforms)
    yield from compatible_tags((int(major), int(minor)), name, platforms)


def fetched(wheel: dict[str, Any]) -> Path:
    """The wheel in the cache, fetched where it is not there yet; its sum is checked in any case."""
    CACHE.mkdir(parents=True, exist_ok=True)
    url, expected = str(wheel["url"]), wheel["hashes"]["sha256"]
    path = CACHE / url.rsplit("/", 1)[1]
    if not path.exists() or sha256(path) != expected:
        fresh = path.with_suffix(f".{os.getpid()}.tmp")
        try:
            with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer, fresh.open("wb") as file:
                shutil.copyfileobj(answer, file)
            if sha256(fresh) != expected:
                raise PackageError(f"{path.name}: not the file that uv.lock names (SHA-256 differs)")
            fresh.replace(path)
        except OSError as error:
            raise PackageError(f"{url}: {error}") from error
        finally:
            fresh.unlink(missing_ok=True)
    return path


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def run(command: list[str], cwd: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """What the command returns and prints. Raises PackageError with what it complained of."""
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if done.returncode:
        raise PackageError(f"{' '.join(command)}: {(done.stderr or done.stdout).strip()[-2000:]}")
    return done
