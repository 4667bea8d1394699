"""The root folders of the boxes: their configuration, and the inventory of the fleet page."""

import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path

from bench.fleet import box
from bench.fleet.certificates import Certificates
from gateway import config, shared_state
from gateway.config.digest import digest

SITES = ("cement-north", "cement-south", "grain-east", "quarry-west")
CONFIG = """\
site = "{site}"
instance = "{name}"
[modbus]
port = 0
[camera]
url = "{camera}"
max_megapixels = 0.4
[ranger]
port = "/dev/ttyACM0"
[fusion]
period_s = 1.0
vision_deadline_s = 5.0
range_deadline_s = 5.0
[records]
enabled = false
[mqtt]
urls = [{urls}]
urls_shuffled = true
events_in_flight = 1
state_period_s = {period_s}
values_period_s = 60.0
[mqtt.tls]
ca_file = "{ca}"
cert_file = "{certificate}"
key_file = "{key}"
{sparkplug}[[bays]]
name = "{name}"
"""
SPARKPLUG = "[mqtt.sparkplug]\nperiod_s = {period_s}\n"
EXPECTED = '[[gateways]]\nsite = "{site}"\ninstance = "{name}"\ndigest = "{digest}"\n'


class Roots:
    """`boxes`: one folder each. They are shared out to SITES, as blocks of equal size."""

    def __init__(
        self,
        folder: Path,
        count: int,
        urls: Sequence[str],
        certificates: Certificates,
        period_s: float,
        sparkplug: bool,
    ) -> None:
        self._urls, self._certificates, self._period_s = urls, certificates, period_s
        self._sparkplug = SPARKPLUG.format(period_s=period_s) if sparkplug else ""
        run = secrets.token_hex(2)  # what a gateway keeps in shared memory has its name: another run has others
        self.boxes = [folder / "boxes" / f"bay-{n:03}-{run}" for n in range(1, count + 1)]
        self.inventory = folder / "inventory.toml"

    def site(self, root: Path) -> str:
        return SITES[self.boxes.index(root) * len(SITES) // len(self.boxes)]

    def reviewed(self, root: Path, camera: str = box.CAMERA) -> str:
        """The text of a box's configuration."""
        own = self._certificates
        return CONFIG.format(
            site=self.site(root), name=root.name, camera=camera, urls=", ".join(f'"{url}"' for url in self._urls),
            period_s=self._period_s, ca=own.ca, certificate=own.certificate(root), key=own.key(root),
            sparkplug=self._sparkplug,
        )  # fmt: skip

    def make(self) -> None:
        """Folders, certificates, configurations with their digests, and the inventory."""
        lines = []
        for root in self.boxes:
            for path in (box.CONFIG, box.LOG, box.PID):
                (root / path).parent.mkdir(parents=True, exist_ok=True)
            for path in (box.STATE, box.RUNTIME):
                (root / path).mkdir(parents=True)
            self._certificates.make(root)
            file = root / box.CONFIG
            file.write_text(self.reviewed(root))
            found = digest(config.load(file))
            file.with_name(f"{file.name}.reviewed").write_text(f"{found}\n")
            lines.append(EXPECTED.format(site=self.site(root), name=root.name, digest=found))
        self.inventory.write_text("".join(lines))

    def forget(self) -> None:
        """What gateways have left in shared memory of events that were not delivered."""
        for root in self.boxes:
            for path in shared_state.folder().glob(f"loading-gateway-*.{root.name}"):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
