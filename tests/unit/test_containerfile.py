"""The container image agrees with the service: user, paths, what is there to be copied."""

import re
import subprocess
import sys
from pathlib import Path

PACKAGING = Path(__file__).parents[2] / "packaging"
TEXT = (PACKAGING / "Containerfile").read_text()
UNIT = (PACKAGING / "systemd/loading-gateway.service").read_text()


def one(pattern: str, text: str) -> str:
    (found,) = re.findall(pattern, text, re.MULTILINE)
    return str(found)


def test_it_runs_what_the_unit_runs_as_the_same_user() -> None:
    user = one(r"^User=(.*)$", UNIT)
    assert one(r"^USER (.*)$", TEXT) == user
    assert one(r"--gid 999 --home-dir /var/lib/(\S+) ", TEXT) == user
    assert one(r"--groups (\S+) ", TEXT).split(",") == one(r"^SupplementaryGroups=(.*)$", UNIT).split()
    program, *arguments = one(r"^ExecStart=(.*)$", UNIT).split()
    assert f"ln -s {program} /usr/bin/{one('^ENTRYPOINT (.*)$', TEXT).strip('[]').strip(chr(34))}" in TEXT
    assert one(r"^CMD \[(.*)\]$", TEXT).replace('"', "").split(", ") == arguments
    assert one(r"^ENV STATE_DIRECTORY=(.*)$", TEXT) == f"/var/lib/{one('^StateDirectory=(.*)$', UNIT)}"
    assert f"VOLUME /var/lib/{user}\n" in TEXT


def test_it_installs_what_the_archive_holds() -> None:
    sys.path.insert(0, str(PACKAGING))
    try:
        import install_version
        import wheelhouse
    finally:
        sys.path.remove(str(PACKAGING))
    assert f"ADD {wheelhouse.PROJECT}-${{VERSION}}-wheels-${{TARGETARCH}}.tar " in TEXT
    assert f"/{Path(install_version.__file__).name} " in TEXT
    assert one(r"^FROM docker.io/library/debian:(\w+)-slim", TEXT) == "bookworm", "its glibc is wheelhouse.GLIBC"
    assert wheelhouse.GLIBC == (2, 36)
    # The health check is a command of the gateway, and not only a port that is open.
    assert '"loading-gateway", "state", "--once"' in one(r"^HEALTHCHECK .* CMD (.*)$", TEXT)


def test_of_several_versions_one_must_be_named(tmp_path: Path) -> None:
    """The step that installs, with `python3` played: what was unpacked into /wheelhouse lies below another folder."""
    step = one(r"^RUN (set -- (?:.*\\\n)*.*)$", TEXT).replace("\\\n", "").replace("/wheelhouse", str(tmp_path))
    step = step.replace("python3 -I", "echo installs")
    for version in ("0.1.0", "0.2.0"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "install_version.py").touch()
        done = subprocess.run(["sh", "-c", step], capture_output=True, text=True, timeout=30, check=False)
        if version == "0.1.0":
            assert done.stdout == f"installs {tmp_path}/0.1.0/install_version.py\n"
    assert (done.returncode, done.stdout) == (1, "")
    assert "--build-arg VERSION=" in done.stderr
