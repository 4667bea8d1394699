"""The package of a new version: its signature, its version, its installation beside the running one."""

import os
import re
import stat
from pathlib import Path

from gateway.update.machine import Machine, ProgramResult, UpdateError
from gateway.update.state import Report

NAME = "loading-gateway"
SHARE = "usr/share/loading-gateway"  # of the unpacked package
SPARE_BYTES = 100_000_000  # for logs, the old files that dpkg still keeps, a package that is larger than the one before
INSTALL_S = 1800.0  # the installation makes a virtual environment; a slow SD card takes minutes
_GNUPG = "[GNUPG:] "
_VERSION = re.compile(r"[0-9][A-Za-z0-9.+~]*")


def need_space(machine: Machine, package: Path, old: str) -> None:
    """Before anything is written: the copy, the unpacked package (of compressed parts: as large as itself), and an
    environment, as large as that of the running version. Raises UpdateError."""
    paths, size = machine.paths, machine.size_bytes(package)
    wanted = (
        (paths.folder, size),
        (paths.root / SHARE, size),
        (paths.versions, machine.size_bytes(paths.versions / old)),
    )
    needed: dict[int, list[tuple[Path, int, int]]] = {}
    for path, count in wanted:
        disk, free = machine.free_bytes(path)
        needed.setdefault(disk, []).append((path, count, free))
    for rows in needed.values():
        total, free = sum(count for _, count, _ in rows) + SPARE_BYTES, rows[0][2]
        if total > free:
            raise UpdateError(
                f"{' and '.join(str(path) for path, *_ in rows)}: {total / 1e6:.0f} MB needed, "
                f"{free / 1e6:.0f} MB free; nothing was begun"
            )


def verify(machine: Machine, package: Path, report: Report, *, signature: Path, unsigned: bool) -> None:
    """The detached OpenPGP signature of `package`. Raises UpdateError."""
    keyrings = [path for path in machine.paths.keyrings if path.is_file()]
    if unsigned:
        report("signature: not verified, as --unsigned asks: whoever made this file is not known")
        return
    if not signature.is_file():
        raise UpdateError(
            f"{signature}: no such file: the package has no signature beside it. Copy it there; a package of your own "
            "is installed with --unsigned"
        )
    if not keyrings:
        paths = " or ".join(map(str, machine.paths.keyrings))
        raise UpdateError(f"no keyring: put the public keys that you trust into {paths} (gpg --export KEY > FILE)")
    options = [word for n, path in enumerate(keyrings) for word in ("--keyring", _kept(machine, path, n))]
    answer = machine.command("gpgv", "--status-fd", "1", *options, signature, package)
    told = dict(_status_lines(answer))
    if answer.code == 0 and "GOODSIG" in told and "VALIDSIG" in told:
        report(f"signature: good, by {told['GOODSIG'].partition(' ')[2]}, key {told['VALIDSIG'].partition(' ')[0]}")
        return
    raise UpdateError(f"{signature}: {_fault(told, answer, package, keyrings)}")


def _kept(machine: Machine, keyring: Path, number: int) -> Path:
    """A copy of the keyring for `gpgv`, in the folder of updates. The service may be able to write into the plant's
    folder: a file of its own there would make its packages trusted, and be run as root. Raises UpdateError."""
    with os.fdopen(_opened(keyring), "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or found.st_uid not in (0, os.geteuid()) or found.st_mode & 0o022:
            raise UpdateError(
                f"{keyring}: others than root can write it, so it is not trusted: look who did, and put your keys "
                "there anew, with chown root and chmod 644"
            )
        data = file.read()
    copy = machine.paths.folder / f"keyring{number}.gpg"
    machine.write(copy, data)
    return copy


def _opened(keyring: Path) -> int:
    """Never waits for a pipe, never follows a link."""
    try:
        return os.open(keyring, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        why = "is a link; a keyring must be a plain file" if keyring.is_symlink() else error.strerror
        raise UpdateError(f"{keyring}: {why}") from error


def _status_lines(answer: ProgramResult) -> list[tuple[str, str]]:
    lines = [line.removeprefix(_GNUPG) for line in answer.out.splitlines() if line.startswith(_GNUPG)]
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines)]


def _fault(told: dict[str, str], answer: ProgramResult, package: Path, keyrings: list[Path]) -> str:
    names = ", ".join(map(str, keyrings))
    if "BADSIG" in told:
        return f"does not fit {package.name}: the file was changed or damaged after it was signed; copy it again"
    if "NO_PUBKEY" in told:
        return f"signed with key {told['NO_PUBKEY']}, which is in none of the keyrings {names}"
    if "EXPKEYSIG" in told:
        return f"the key that signed it has expired ({told['EXPKEYSIG']}): a newer keyring is needed in {names}"
    if "EXPSIG" in told or "REVKEYSIG" in told:
        return "the signature has expired, or its key was revoked"
    return f"no signature that can be verified: {answer.last_lines}"


def version_of(machine: Machine, package: Path) -> str:
    """The version that it brings: that of its folder below versions/. Raises UpdateError."""
    answer = machine.command("dpkg-deb", "--field", package, "Package", "Version")
    fields = dict(line.partition(": ")[::2] for line in answer.out.splitlines())
    if answer.code != 0 or not fields.get("Version"):
        raise UpdateError(f"{package}: not a Debian package: {answer.last_lines}")
    if fields.get("Package") != NAME:
        raise UpdateError(f"{package}: the package of {fields.get('Package')}, and not of {NAME}")
    version = fields["Version"].partition(":")[2] or fields["Version"]  # without Debian's epoch
    version = version.rpartition("-")[0] or version  # and without its revision
    if not _VERSION.fullmatch(version):
        raise UpdateError(f"{package}: version {version!r} is none")
    return version


def run_dpkg(machine: Machine) -> ProgramResult:
    """Install the copy. The plant's own configuration files stay as they are, without a question."""
    words = ("dpkg", "--force-confdef", "--force-confold", "--install", machine.paths.package)
    return machine.command(*words, timeout_s=INSTALL_S)


def configure(machine: Machine) -> ProgramResult:
    """Complete a package that is unpacked."""
    return machine.command("dpkg", "--configure", NAME, timeout_s=INSTALL_S)


def dpkg_fault(answer: ProgramResult) -> str:
    """dpkg's own error, and what the package's script wrote before it; not the list of packages at its end."""
    own = answer.err.partition("Errors were encountered while processing:")[0]
    return ProgramResult(answer.code, err=own).last_lines if own.strip() else answer.last_lines


def is_installed(machine: Machine) -> bool:
    """Does dpkg have the package completely?"""
    answer = machine.command("dpkg-query", "--show", "--showformat=${db:Status-Abbrev}", NAME)
    return answer.code == 0 and answer.out.strip() == "ii"


def install(machine: Machine, version: str, report: Report) -> None:
    """The copy of the package, beside the running version. Raises UpdateError."""
    machine.remove(machine.paths.rejected)  # it gets another try
    answer = run_dpkg(machine)
    if answer.code != 0:
        raise UpdateError(f"dpkg --install: {dpkg_fault(answer)}")
    executable = machine.paths.executable(version)
    if not executable.exists():
        raise UpdateError(f"the package was installed, but has made no {executable}")
    told = machine.command(executable, "--version")
    if told.code != 0 or told.out.split()[-1:] != [version]:
        raise UpdateError(f"{executable} --version: {told.last_lines}, and not {version}")
    report(f"installed: {executable}")
