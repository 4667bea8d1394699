"""What a technician tries of a camera's controls, kept in the main process: a vision process may be replaced meanwhile.

What is tried is not in the file: when the trial ends, the camera is put back to the file's values, or to what it was.
A trial does not outlive the main process, which puts the camera back before it ends (`VisionService.put_back`).
"""

from dataclasses import dataclass, field

from gateway.config import CameraConfig, ControlsConfig
from gateway.errors import ConfigError
from gateway.vision.source.v4l2_controls import settings_of
from gateway.vision.transport.messages import ControlsReport, ControlsRequest


@dataclass(slots=True)
class ControlsTrial:
    """Of one bay. `report`: the newest of its vision process; None: none since the last change."""

    tried: ControlsConfig = field(default_factory=ControlsConfig)
    report: ControlsReport | None = None
    _number: int = 0  # of the last change
    _found: dict[str, int] = field(default_factory=dict)

    def set(self, tried: ControlsConfig, camera: CameraConfig) -> None:
        """Complete; nothing: the trial ends. Raises ConfigError for what is not to be set by hand."""
        for key in camera.owned_controls:
            if getattr(tried, key) is not None:
                raise ConfigError(f'{key}: camera.exposure = "marker" sets it')
        self.tried, self.report = tried, None
        self._number += 1

    @property
    def under_way(self) -> bool:
        """A new vision process must be told."""
        return bool(self._found) or self.tried != ControlsConfig()

    @property
    def ended(self) -> bool:
        """Nothing is tried any more, and the camera has confirmed that."""
        return not self.under_way and (self._number == 0 or self.report is not None)

    def message(self) -> ControlsRequest:
        return ControlsRequest(self._number, settings_of(self.tried), dict(self._found))

    def reported(self, report: ControlsReport) -> None:
        if report.number == self._number:
            self.report = report
        self._found = dict(report.found)
