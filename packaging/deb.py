"""The Debian package: the wheelhouse, the service's files, and the scripts of packaging/debian."""

import gzip
import hashlib
import io
import os
import shutil
import subprocess
from contextlib import redirect_stdout, suppress
from datetime import UTC, datetime
from pathlib import Path

from wheelhouse import ROOT, Architecture, run

from gateway.cli.main import VERBS, main

HERE = ROOT / "packaging"
NAME = "loading-gateway"
SHARE = f"usr/share/{NAME}"
SCRIPTS = ("postinst", "prerm", "postrm")


def write(
    tree: Path, wheelhouse: Path, target: Path, architecture: Architecture, version: str, epoch: int, keyring: bytes
) -> None:
    """Write the package `target`; `tree` is a folder to work in, `keyring` the keys its successors are signed with."""
    tree.mkdir()
    shutil.copytree(wheelhouse, tree / SHARE, copy_function=os.link)
    if keyring:
        (tree / SHARE / "release.gpg").write_bytes(keyring)
    files = {
        f"{SHARE}/gateway.toml": HERE / "debian/gateway.toml",
        f"{SHARE}/avahi.service": HERE / "debian/avahi.service",
        f"usr/lib/sysusers.d/{NAME}.conf": HERE / f"sysusers/{NAME}.conf",
        f"usr/lib/udev/rules.d/70-{NAME}.rules": HERE / f"udev/70-{NAME}.rules",
        f"usr/share/doc/{NAME}/copyright": HERE / "debian/copyright",
        f"usr/share/lintian/overrides/{NAME}": HERE / "debian/lintian-overrides",
        **{f"usr/lib/systemd/system/{unit.name}": unit for unit in (HERE / "systemd").iterdir()},
    }
    for name, source in files.items():
        copied(source.read_bytes(), tree / name)
    when = datetime.fromtimestamp(epoch, UTC).strftime("%a, %d %b %Y %H:%M:%S +0000")
    filled = {"@VERSION@": version, "@ARCHITECTURE@": architecture.name, "@DATE@": when}
    documents = tree / f"usr/share/doc/{NAME}"
    compressed(fill(HERE / "debian/changelog", filled).encode(), documents / "changelog.gz")
    compressed((ROOT / "CHANGELOG.md").read_bytes(), documents / "CHANGELOG.md.gz")
    for page in (*(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("images/*")):
        copied(page.read_bytes(), documents / "manual" / page.relative_to(ROOT / "docs"))
    manual = tree / "usr/share/man/man1"
    compressed(man_page(version, when).encode(), manual / "gateway.1.gz")
    (manual / f"{NAME}.1.gz").symlink_to("gateway.1.gz")
    (documents / "sbom.cdx.json").symlink_to(f"../../{NAME}/sbom.cdx.json")
    (tree / "usr/bin").mkdir()
    (tree / f"usr/bin/{NAME}").symlink_to(f"/opt/{NAME}/current/bin/gateway")
    everything = [path for path in sorted(tree.rglob("*")) if path.is_file() and not path.is_symlink()]
    filled["@SIZE@"] = str(sum(path.stat().st_size for path in everything) // 1024 + 1)
    control = tree / "DEBIAN"
    copied(fill(HERE / "debian/control", filled).encode(), control / "control")
    copied((HERE / "debian/triggers").read_bytes(), control / "triggers")
    sums = [f"{md5(path)}  {path.relative_to(tree)}\n" for path in everything]
    copied("".join(sums).encode(), control / "md5sums")
    for name in SCRIPTS:
        copied((HERE / "debian" / name).read_bytes(), control / name, 0o755)
    for folder in (path for path in tree.rglob("*") if path.is_dir()):
        folder.chmod(0o755)
    # The lowest level: wheels are compressed already.
    command = ["dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", str(tree), str(target)]
    run(command, cwd=ROOT, env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch)})


def sign(target: Path, key: str) -> None:
    """`TARGET.asc`, a detached signature by a key of the caller's GnuPG."""
    signature = target.with_name(f"{target.name}.asc")
    signature.unlink(missing_ok=True)
    # With the caller's terminal: GnuPG may ask for the key's password.
    subprocess.run(
        ["gpg", "--local-user", key, "--armor", "--detach-sign", "--output", str(signature), str(target)], check=True
    )


def public_keys(key: str) -> bytes:
    return subprocess.run(["gpg", "--export", key], check=True, capture_output=True).stdout


def copied(content: bytes, target: Path, mode: int = 0o644) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)
    target.chmod(mode)


def compressed(content: bytes, target: Path) -> None:
    copied(gzip.compress(content, 9, mtime=0), target)


def man_page(version: str, when: str) -> str:
    """gateway(1), in roff: what the command's own --help prints, of each verb too."""
    parts = [
        f'.TH GATEWAY 1 "{when}" "{NAME} {version}"',
        ".SH NAME\ngateway \\- reports to a PLC when a truck stands under the loading spout",
        f".SH DESCRIPTION\nInstalled as /usr/bin/{NAME}. The manual: /usr/share/doc/{NAME}/manual/technician.md.",
        f".SH GATEWAY\n.nf\n{roff(helped())}.fi",
        *(f".SH GATEWAY {verb.upper()}\n.nf\n{roff(helped(verb))}.fi" for verb in VERBS),
    ]
    return "\n".join(parts) + "\n"


def helped(*words: str) -> str:
    os.environ["COLUMNS"] = "80"  # whatever terminal the package is built in
    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):
        main([*words, "--help"])
    return printed.getvalue()


def roff(text: str) -> str:
    """As it stands: no line is a request, no character an escape."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq").replace("`", "\\(ga")
    return "".join(f"\\&{line}" for line in escaped.splitlines(keepends=True))


def fill(template: Path, values: dict[str, str]) -> str:
    text = template.read_text()
    for name, value in values.items():
        text = text.replace(name, value)
    return text


def md5(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()
