"""Build what an installation without a network needs into dist/: `./dev package`.

plc-loading-gateway-VERSION-wheels-ARCH.tar   every wheel with its hash, and what makes an installation of them
loading-gateway_VERSION_ARCH.deb              the same as a Debian package, with the service
loading-gateway_VERSION_ARCH.deb.asc          its signature, with --sign
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import deb
import wheelhouse
from wheelhouse import ARCHITECTURES, ROOT, PackageError

PYTHONS = ["3.11", "3.12", "3.13", "3.14"]


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="./dev package", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    machine = os.uname().machine
    here = next((name for name, one in ARCHITECTURES.items() if one.machine == machine), "amd64")
    parser.add_argument("--arch", choices=[*ARCHITECTURES, "all"], default=here, help="default: this machine's")
    parser.add_argument("--sign", metavar="KEY", help="a key of your GnuPG; the package carries its public part")
    parser.add_argument("--python", metavar="X.Y", action="append", choices=PYTHONS, help="only for this; repeatable")
    parser.add_argument("--version", metavar="V", help="another version than pyproject.toml's, for trials")
    parser.add_argument("--into", metavar="FOLDER", type=Path, default=ROOT / "dist")
    args = parser.parse_args()
    version = args.version or tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    if not re.fullmatch(r"\d+(\.\d+)*([a-z]+\d+)?", version):
        parser.error(f"--version {version}: numbers with points, as 1.2.3 or 1.2.3rc1")
    names = list(ARCHITECTURES) if args.arch == "all" else [args.arch]
    try:
        keyring = deb.public_keys(args.sign) if args.sign else b""
        for name in names:
            for path in build(name, args.python or PYTHONS, version, keyring, args.into.absolute()):
                if args.sign and path.suffix == ".deb":
                    deb.sign(path, args.sign)
                print(f"{path}  {path.stat().st_size / 1e6:.1f} MB")
    except (PackageError, subprocess.SubprocessError, OSError) as error:
        print(f"./dev package: {error}", file=sys.stderr)
        return 1
    return 0


def build(name: str, pythons: list[str], version: str, keyring: bytes, into: Path) -> list[Path]:
    """The files for one architecture, each put in its place when it is complete."""
    architecture = ARCHITECTURES[name]
    epoch = source_date()
    into.mkdir(parents=True, exist_ok=True)
    archive = into / f"{wheelhouse.PROJECT}-{version}-wheels-{name}.tar"
    package = into / f"{deb.NAME}_{version}_{name}.deb"
    scratch = Path(tempfile.mkdtemp(prefix=".package-", dir=into))
    try:
        wheelhouse.write(scratch / "wheelhouse", architecture, pythons, version, epoch)
        wheelhouse.archive(scratch / "wheelhouse", scratch / archive.name, epoch)
        deb.write(
            scratch / "tree", scratch / "wheelhouse", scratch / package.name, architecture, version, epoch, keyring
        )
        for path in (archive, package):
            (scratch / path.name).replace(path)
    finally:
        shutil.rmtree(scratch)
    return [archive, package]


def source_date() -> int:
    """The date of all files in the packages, so that the same sources give the same bytes: the last commit's."""
    if stated := os.environ.get("SOURCE_DATE_EPOCH"):
        return int(stated)
    command = ["git", "log", "-1", "--format=%ct"]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        done = None
    return int(done.stdout) if done and done.stdout.strip() else int((ROOT / "CHANGELOG.md").stat().st_mtime)


if __name__ == "__main__":
    sys.exit(main())
