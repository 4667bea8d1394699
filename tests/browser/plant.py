"""A simulated bay with its pages, as a user starts it: `gateway simulate` with a configuration file of its own."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit
from uuid import uuid4

import psutil

from tests.e2e.processes import Gateway

# The truck moves to and fro without an end, and all goes well. Ten frames a second leave the machine to the browser.
TO_AND_FRO = """
seed = 7
repeat = true
camera = { fps = 10 }
start = { distance_cm = 70 }
legs = [
  { distance_cm = 45, speed_cm_s = 10 },
  { distance_cm = 70, speed_cm_s = 10 },
]
"""
STANDING = """
seed = 3
camera = { fps = 10 }
start = { distance_cm = 45 }
"""
CONFIG = """\
# The bay of a test. This comment and the others must outlive whatever a page writes here.
site = "north_works"
instance = "{instance}"
log_level = "warning"

[hmi]
enabled = true
port = 0                      # any free one
without_login = "{role}"
{users}
[camera]
deadline_s = 3.0              # on a busy machine, too

[vision]                      # the paper's method: its mask is what its thresholds make it
method = "paper"
min_area_px2 = 200.0          # smaller red things are no marker

[fusion.cross_check]          # the simulated camera's
focal_px = 600.0
marker_radius_mm = 90.0

[guidance]
aim_u_px = 319.5
aim_v_px = 239.5
"""
FOR_EVER = """
[records]                     # what a test has recorded already may be of any day
max_days = 0
visit_days = 0
picture_days = 0
"""


@dataclass
class Plant:
    gateway: Gateway
    config: Path
    url: str  # ends without a slash
    modbus_port: int

    def process(self, name: str) -> psutil.Process:
        """A child by the name it gives itself."""
        (found,) = (each for each in self.gateway.family() if each.name() == name)
        return found


@contextlib.contextmanager
def plant(
    folder: Path,
    scenario: str = TO_AND_FRO,
    *,
    role: str = "technician",
    users: str = "",
    bays: int = 1,
    records: Callable[[Path], None] | None = None,
    hmi_port: int = 0,
    keeps: bool = False,
    more: str = "",
) -> Iterator[Plant]:
    """Runs until the block ends; leaves no process behind. `records`: it records, and this makes what it has recorded
    already, in the folder of all bays. `hmi_port`: 0: any. `keeps`: it has a folder for its state. `more`: of the
    configuration."""
    config, story = folder / "plant.toml", folder / "scenario.toml"
    instance = f"test-{uuid4().hex[:12]}"
    text = CONFIG.format(instance=instance, role=role, users=users) + more
    config.write_text(text if records is None else text + FOR_EVER)
    story.write_text(scenario)
    state = ("--state-dir", str(folder / "state")) if keeps or records is not None else ()
    if records is not None:
        records(folder / "state" / "records" / f"north_works.{instance}")
    with Gateway(
        *("simulate", "--json", "--config", str(config), "--scenario", str(story)),
        *("--modbus-port", "0", "--hmi-port", str(hmi_port), *state),
        *(("--bays", str(bays)) if bays > 1 else ()),
    ) as gateway:
        started = gateway.started()
        url = started["hmi"].rstrip("/")
        first_visit(url)
        yield Plant(gateway, config, url, started["modbus_port"])


def first_visit(url: str) -> None:
    """It starts the web process, which gives way to everything else: on a busy machine that takes its time."""
    where = urlsplit(url)
    connection = HTTPConnection(where.netloc, timeout=100)
    try:
        connection.request("GET", f"{where.path}/driver")
        assert connection.getresponse().status == 200
    finally:
        connection.close()
