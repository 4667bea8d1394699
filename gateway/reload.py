"""The configuration file is read again while the gateway runs, and what is live of it is put into effect. IO.

What is live: gateway/config/live.py. A file with a fault changes nothing: the log names file, line, key, value and
range, and the alarm configuration_not_loaded is raised until a good file has been read.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

from gateway.bay import BayControl
from gateway.bay_file import BayFiles
from gateway.config import GatewayConfig, VisionConfig, decision, live
from gateway.config.live import Change
from gateway.core.events import MAX_DETAIL_CHARS
from gateway.core.plc import Writer
from gateway.errors import ConfigError
from gateway.records.recorder_service import RecorderService
from gateway.systemd import ServiceState
from gateway.vision.process.vision_service import VisionService
from gateway.web.host.status import StatusCollector
from gateway.web.host.web_process_service import WebProcessService

log = logging.getLogger(__name__)

FILE = Writer("configuration file")


@dataclass(slots=True)
class ReloadRequests:
    """`load` reads and checks the file, in a thread; it raises ConfigError. `set_level` changes that of the log."""

    load: Callable[[], GatewayConfig]
    set_level: Callable[[str], None] = lambda _: None
    requested: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(slots=True)
class InForce:
    """The settings in force: `config`, with those of vision that a technician has applied."""

    config: GatewayConfig
    visions: Mapping[str, VisionService]
    _whole: tuple[object, GatewayConfig] | None = None  # what it is made of, and it

    def of(self, bay: str) -> tuple[GatewayConfig, VisionConfig]:
        """What the keys of the bay's decision are made of: another object where they may be others."""
        return self.config, self.visions[bay].settings

    def whole(self) -> GatewayConfig:
        """With the applied settings of vision in it; the same object while they are the same."""
        applied = [self.visions[bay.name].settings for bay in self.config.bays]
        made_of = (self.config, *applied)
        if self._whole is None or self._whole[0] != made_of:
            pairs = zip(self.config.bays, applied, strict=True)
            bays = tuple(bay.model_copy(update={"vision": settings}) for bay, settings in pairs)
            self._whole = made_of, self.config.model_copy(update={"bays": bays})
        return self._whole[1]

    def deciding(self, bay: str) -> dict[str, Any]:
        """The keys of the bay's decision."""
        (own,) = [one for one in self.config.bays if one.name == bay]
        return decision.keys_of(own.model_copy(update={"vision": self.visions[bay].settings}), self.config)


@dataclass(frozen=True, slots=True)
class Reloader:
    """What the configuration in force is replaced by is handed to these parts."""

    requests: ReloadRequests
    in_force: InForce
    controls: Mapping[str, BayControl]
    recorder: RecorderService
    pages: WebProcessService | None
    status: StatusCollector
    service: ServiceState
    files: BayFiles | None = None

    async def run(self) -> NoReturn:
        """One reload after each request; requests that come meanwhile are one."""
        while True:
            await self.requests.requested.wait()
            self.requests.requested.clear()
            self.service.reloading()
            try:
                await self._reload()
            finally:
                self.service.reloaded()

    async def _reload(self) -> None:
        try:
            new = await asyncio.to_thread(self.requests.load)
        except ConfigError as error:
            lines = str(error).split("\n")
            self.status.config_fault = lines[0]
            for line in lines:
                log.error("the configuration was not loaded, and nothing has changed: %s", line)
            return
        self.status.config_fault = ""
        found = live.changes(self.in_force.config, new)
        waiting = [change for change in found if not change.live]
        self.status.keys_waiting = len(waiting)
        self._apply(live.in_force(self.in_force.config, new), [change for change in found if change.live])
        for change in waiting:
            log.warning("configuration: waits for a restart: %s", change)
        if not found:
            log.info("the configuration was read again: nothing in it has changed")

    def _apply(self, config: GatewayConfig, found: Sequence[Change]) -> None:
        self.in_force.config = config
        sections = {change.path[0] for change in found}
        if "log_level" in sections:
            self.requests.set_level(config.log_level)
        for change in found:
            log.info("configuration: in effect: %s", change)
        if self.status.certificates is not None:
            self.status.certificates.use(config)
        if "records" in sections:
            self.recorder.apply(config)
        if self.pages is not None and sections & {"hmi", "records"}:  # the pages' rights to pictures are in [records]
            self.pages.apply(config)
        for bay in config.bays:
            control, vision = self.controls[bay.name], self.in_force.visions[bay.name]
            own = [change for change in found if change.path[0] != "bays" or change.path[1] == bay.name]
            fixed = any("controls" in change.path for change in own)
            if any(change.path[0] == "bays" for change in own) and (fixed or vision.settings != bay.vision):
                vision.apply(bay.vision, bay.camera.controls if fixed else None)
                control.vision_changed(bay)
                if self.files is not None:
                    control.check_untried(self.files.untried(bay.name), FILE)
            if own:
                control.settings_changed("; ".join(map(str, own))[:MAX_DETAIL_CHARS], FILE)
