"""`gateway update` with real gateways as versions: a real package, signature, files, links and processes. systemd is
played: a thread that does what the unit says, and a `systemctl` that tells it; dpkg only unpacks."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import uuid
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest

from gateway.update import state as states
from gateway.update.machine import InstallPaths, Machine
from gateway.update.state import Outcome, Stage, UpdateState
from tests.e2e.ansible_boxes import Boxes
from tests.e2e.brokers import free_port
from tests.e2e.sim_ranger import Ranger
from tests.long import mostly_long

pytestmark = pytest.mark.timeout(300)  # it waits for programs that start, on a machine with other load
REPOSITORY = Path(__file__).parents[2]
EXITS = "from gateway.cli import run; run.main = lambda args: 3"
NO_FRAMES = (
    "from gateway.parts import Ports; from gateway.vision.source.specs import FileSpec; "
    "from dataclasses import replace; "
    "of = Ports.of; Ports.of = staticmethod(lambda config: replace(of(config), "
    "camera=dict.fromkeys(of(config).camera, FileSpec('nothing'))))"
)
ALARM = (
    "from gateway.web.host.status import StatusCollector as S; from dataclasses import replace; of = S.conditions; "
    "S.conditions = lambda self: replace(of(self), bay_file_damaged='bay1: cut off')"
)
LOADS = (  # stop 0, may_move 1, in_place 1 for ever, whatever is decided
    "from gateway.modbus.registers import bay_unit; of = bay_unit.encode; "
    "bay_unit.encode = lambda *a: (i := of(*a))[:4] + (0, 1) + i[6:36] + (1,) + i[37:]"
)
EXECUTABLE = """\
#!{python} -B
import sys
from functools import partial
from pathlib import Path
sys.path[:0] = [{repository!r}]
import gateway
gateway.__version__ = {version!r}
from gateway.update import machine
machine.Machine = partial(machine.Machine, machine.InstallPaths(Path({root!r})), {programs!r})
{patch}
from gateway.cli import main
sys.exit(main())
"""


class Plant(threading.Thread):
    """A machine below `root` with an installed version 1.0; the thread is its systemd."""

    def __init__(self, root: Path, ranger: str, video: Path) -> None:
        super().__init__(daemon=True)
        self.root = root
        self.paths = InstallPaths(root)
        self.systemd = root / "systemd"
        self.programs = {name: str(root / "bin" / name) for name in ("systemctl", "dpkg")}
        self.end = threading.Event()
        self.watcher: subprocess.Popen[bytes] | None = None
        self.kill_watcher = False
        for folder in (self.systemd, root / "bin", self.paths.config.parent, self.paths.status.parent):
            folder.mkdir(parents=True)
        self._script("systemctl", f"""\
case "$1 $2 $3 $4" in
  "show loading-gateway.service -p User") echo User= ;;
  "show loading-gateway.service -p ActiveState") cat {self.systemd}/show ;;
  "stop loading-gateway-update.service  ")
    touch "{self.systemd}/$1 $2"
    while [ -e "{self.systemd}/$1 $2" ]; do sleep 0.05; done ;;
  *" --no-block "*) touch "{self.systemd}/$1 $3" ;;
  *) echo "not played: $*" >&2; exit 1 ;;
esac
""")  # fmt: skip
        self._script("dpkg", f'for last; do :; done; exec dpkg-deb --extract "$last" {root}\n')
        self._put(root, "1.0", "")
        self.paths.current.symlink_to("versions/1.0")
        self.paths.config.write_text(f"""\
instance = "update-{os.getpid()}-{free_port()}"
state_dir = "{root}/kept"
modbus.port = {free_port()}
camera = {{ url = "{video}", loop = true, width_px = 160, height_px = 120 }}
ranger.port = "{ranger}"
""")

    def _script(self, name: str, text: str) -> None:
        path = self.root / "bin" / name
        path.write_text(f"#!/bin/sh\n{text}")
        path.chmod(0o755)

    def _put(self, tree: Path, version: str, patch: str) -> None:
        path = tree / f"opt/loading-gateway/versions/{version}/bin/gateway"
        path.parent.mkdir(parents=True)
        path.write_text(EXECUTABLE.format(python=sys.executable, repository=str(REPOSITORY), version=version,
                                          root=str(self.root), programs=self.programs, patch=patch))  # fmt: skip
        path.chmod(0o755)

    def package(self, version: str, patch: str) -> Path:
        """Signed, with the key in the plant's keyring."""
        tree = self.root / f"package-{version}"
        self._put(tree, version, patch)
        (tree / "DEBIAN").mkdir()
        control = f"Package: loading-gateway\nVersion: {version}\nArchitecture: all\nMaintainer: a\nDescription: b\n"
        (tree / "DEBIAN/control").write_text(control)
        path = self.root / f"loading-gateway_{version}_all.deb"
        subprocess.run(["dpkg-deb", "--build", tree, path], check=True, capture_output=True)
        with tempfile.TemporaryDirectory(prefix="lgk") as home:
            for words in (
                f"gpg --homedir {home} --batch --quiet --passphrase= --quick-gen-key maker ed25519 sign never",
                f"gpg --homedir {home} --batch --quiet --yes --output {self.paths.keyrings[0]} --export maker",
                f"gpg --homedir {home} --batch --quiet --armor --output {path}.asc --detach-sign {path}",
                f"gpgconf --homedir {home} --kill all",
            ):
                subprocess.run(words.split(), check=True, capture_output=True, timeout=60)
        return path

    # systemd.

    def run(self) -> None:
        service = self._begun()
        while not self.end.wait(0.05):
            if service.poll() is not None:
                self._show("activating", 0, "")
                self.end.wait(0.2)
                service = self._begun()
            if self._told("restart loading-gateway.service"):
                service.send_signal(signal.SIGTERM)
                service.wait(20)
                service = self._begun()
            if (self.systemd / "stop loading-gateway-update.service").exists():
                self._stop_watcher()
            if self._told("start loading-gateway-update.service") or (
                self.watcher is not None and self.watcher.poll() not in (None, 0)
            ):
                command: list[str | Path] = [self.paths.watcher / "bin/gateway", "update", "--resume"]
                self.watcher = subprocess.Popen(command, stdout=subprocess.DEVNULL)
            if self.kill_watcher and self.watcher is not None and self.proves():
                self.kill_watcher = False
                self.watcher.kill()
                self.watcher.wait(10)
        for process in (service, self.watcher):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(20)

    def _stop_watcher(self) -> None:
        """Whoever asks waits until it has ended."""
        if self.watcher is not None and self.watcher.poll() is None:
            self.watcher.terminate()
            self.watcher.wait(20)
        self.watcher = None
        self._told("stop loading-gateway-update.service")

    def proves(self) -> bool:
        state = states.read(Machine(self.paths))
        return state is not None and state.stage is Stage.PROVING

    def _told(self, what: str) -> bool:
        path = self.systemd / what
        told = path.exists()
        path.unlink(missing_ok=True)
        return told

    def _begun(self) -> "subprocess.Popen[bytes]":
        env = os.environ | {"RUNTIME_DIRECTORY": str(self.paths.status.parent)}
        command: list[str | Path] = [self.paths.current / "bin/gateway", "run", self.paths.config]
        log = (self.root / "journal").open("ab")
        process = subprocess.Popen(command, env=env, stdout=log, stderr=log)
        log.close()
        self._show("active", process.pid, uuid.uuid4().hex)
        return process

    def _show(self, state: str, pid: int, invocation: str) -> None:
        fresh = self.systemd / "show.new"
        fresh.write_text(f"ActiveState={state}\nMainPID={pid}\nInvocationID={invocation}\n")
        fresh.replace(self.systemd / "show")

    # Who updates.

    def gateway(self, *words: str | Path) -> "subprocess.CompletedProcess[str]":
        command = [self.paths.current / "bin/gateway", *words]
        return subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)

    def is_empty(self) -> None:
        """Waits until the gateway reports that no truck is there."""
        for _ in range(1200):
            if self.paths.status.is_file() and '"empty"' in self.paths.status.read_text():
                return
            self.end.wait(0.05)
        raise AssertionError((self.root / "journal").read_text())

    def update(self, version: str, patch: str, within_s: int) -> tuple[UpdateState, str]:
        package = self.package(version, patch)
        self.is_empty()
        done = self.gateway("update", package, "--within", str(within_s), "--steady", "5")
        state = states.read(Machine(self.paths))
        assert state is not None, done.stderr
        assert done.returncode == (state.outcome is not Outcome.UPDATED), done.stdout + done.stderr
        return state, done.stdout


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty bay."""
    random = np.random.default_rng(1)
    grey = cv2.resize(random.integers(20, 230, (12, 16), np.uint8), (160, 120), interpolation=cv2.INTER_CUBIC)
    path = tmp_path_factory.mktemp("video") / "empty.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (160, 120))
    for _ in range(30):
        noisy = np.clip(grey.astype(np.int16) + random.integers(-6, 7, grey.shape), 0, 255).astype(np.uint8)
        writer.write(cv2.cvtColor(noisy, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.fixture
def plant(tmp_path: Path, video: Path) -> Iterator[Plant]:
    with Ranger() as ranger:
        ranger.distance_mm = 3500.0
        made = Plant(tmp_path, ranger.port, video)
        made.start()
        yield made
        made.end.set()
        made.join(60)


@pytest.mark.long
def test_a_good_version_whose_watcher_is_killed_is_taken_and_back_by_hand_returns(plant: Plant) -> None:
    plant.kill_watcher = True
    state, told = plant.update("2.0", "", 60)
    assert (state.outcome, state.resumed) == (Outcome.UPDATED, 1), told
    assert "the watcher was ended while 2.0 was being proven: it is proven again" in told
    assert "signature: good, by maker" in told
    assert "decisions taken again, none is other" in told
    assert '"version": "2.0"' in plant.paths.status.read_text()
    shown = plant.gateway("update", "--status").stdout
    assert "in use:    2.0\ninstalled: 1.0, 2.0\nrunning:   2.0" in shown
    assert "previous:  1.0\nupdate:    from 1.0 to 2.0: updated" in shown
    assert plant.gateway("update", "--back", "--within", "60", "--steady", "5").returncode == 0
    assert '"version": "1.0"' in plant.paths.status.read_text()


@pytest.mark.long
def test_back_by_hand_ends_an_update_while_it_is_proven(plant: Plant) -> None:
    """The emergency brake: it ends the watcher, which waits and sleeps, and has the old version back."""
    package = plant.package("2.0", "")
    plant.is_empty()
    command: list[str | Path] = [plant.paths.current / "bin/gateway", "update", package]
    command += ["--within", "120", "--steady", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as update:
        for _ in range(2400):
            if plant.proves():
                break
            plant.end.wait(0.05)
        back = plant.gateway("update", "--back")
        told = update.communicate(timeout=60)[0]
    assert back.returncode == 0, back.stdout + back.stderr + told
    assert update.returncode == 1, told
    assert "returned to 1.0, which is proven. 2.0 was not taken: ended by hand" in back.stdout
    state = states.read(Machine(plant.paths))
    assert state is not None
    assert (state.outcome, state.why) == (Outcome.RETURNED, "ended by hand")
    assert os.readlink(plant.paths.current) == "versions/1.0"
    assert '"version": "1.0"' in plant.paths.status.read_text()
    assert plant.paths.rejected.read_text() == "2.0\n"


@pytest.mark.long
@pytest.mark.parametrize(
    ("patch", "within_s", "why"),
    mostly_long(
        [
            (EXITS, 60, "it was started again by itself: its process has ended"),
            (NO_FRAMES, 10, "bay1: no frames of its camera: "),
            (ALARM, 10, "new alarm bay_file_damaged (bay1: cut off)"),
            (LOADS, 60, "bay1: its registers are not what is decided: the image contradicts itself"),
        ]
    ),
    ids=["exits", "no-frames", "alarm", "loads"],
)
def test_a_worse_version_goes_back_by_itself(plant: Plant, patch: str, within_s: int, why: str) -> None:
    state, told = plant.update("2.0", patch, within_s)
    assert state.outcome is Outcome.RETURNED, told
    assert why in state.why, told
    assert os.readlink(plant.paths.current) == "versions/1.0"
    assert '"version": "1.0"' in plant.paths.status.read_text()
    assert sorted(path.name for path in plant.paths.versions.iterdir()) == ["1.0"]


@pytest.fixture
def plants(tmp_path: Path, video: Path) -> Iterator[list[Plant]]:
    """Two machines, for Ansible."""
    with ExitStack() as stack:
        made = []
        for name in ("bay-1", "bay-2"):
            ranger = stack.enter_context(Ranger())
            ranger.distance_mm = 3500.0
            made.append(Plant(tmp_path / "boxes" / name, ranger.port, video))
        for plant in made:
            plant.start()
        yield made
        for plant in made:
            plant.end.set()
        for plant in made:
            plant.join(60)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_ansible_updates_ring_by_ring_and_a_worse_version_reaches_no_later_ring(
    plants: list[Plant], tmp_path: Path
) -> None:
    control = Boxes(tmp_path, ["bay-1", "bay-2"])
    control.control()

    def play(version: str, **extra: object) -> "subprocess.CompletedProcess[str]":
        package = f"{{{{ inventory_dir }}}}/boxes/{{{{ inventory_hostname }}}}/loading-gateway_{version}_all.deb"
        # On a busy machine a sensor may be late at the very moment of the switch: --now.
        options = ["--now", "--within", "120", "--steady", "5"]
        return control.play("update", package=package, update_options=options, **extra)

    for plant in plants:
        plant.package("2.0", EXITS)
        plant.is_empty()
    second = (plants[1].systemd / "show").read_text()
    done = play("2.0")
    assert done.returncode == 2, done.stdout
    assert "its process has ended" in done.stdout.split("Not proven: bay-1: ", 1)[1].splitlines()[0]
    assert '"version": "1.0"' in plants[0].paths.status.read_text()
    assert (plants[1].systemd / "show").read_text() == second, "it was not started again"
    assert not plants[1].paths.folder.exists(), "nor was an update begun"

    for plant in plants:
        plant.package("3.0", "")
    done = play("3.0")
    assert done.returncode == 0, done.stdout + done.stderr
    assert [os.readlink(plant.paths.current) for plant in plants] == ["versions/3.0"] * 2
    assert all('"version": "3.0"' in plant.paths.status.read_text() for plant in plants)
    assert not list(tmp_path.glob("boxes/*/var/tmp/*"))
    done = play("3.0")
    assert done.returncode == 0, done.stdout
    assert done.stdout.count("changed=0") == 2, "the same again changes nothing"

    plants[0].package("4.0", "")
    plants[1].package("4.0", EXITS)
    done = play("4.0", rings=["100%"])
    assert done.returncode == 2, done.stdout
    assert "bay-1: back at what it was. Not proven: bay-2: " in done.stdout
    assert all('"version": "3.0"' in plant.paths.status.read_text() for plant in plants)
