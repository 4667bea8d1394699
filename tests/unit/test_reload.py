"""What a reload hands to the vision of a bay."""

import asyncio
from typing import Any, cast

import pytest

from gateway.config import BayConfig, CameraConfig, ControlsConfig, GatewayConfig, VisionConfig
from gateway.reload import InForce, Reloader, ReloadRequests


class Part:
    """Notes what it is given; stands in for whatever is not looked at."""

    certificates = None

    def __init__(self) -> None:
        self.settings = VisionConfig()
        self.applied: list[tuple[VisionConfig, ControlsConfig | None]] = []
        self.told: list[str] = []
        self.seen: BayConfig | None = None

    def apply(self, vision: VisionConfig, controls: ControlsConfig | None = None) -> None:
        self.applied.append((vision, controls))

    def vision_changed(self, config: BayConfig) -> None:
        self.seen = config

    def settings_changed(self, what: str, who: object) -> None:
        self.told.append(what)

    def check_untried(self, untried: object, who: object) -> None:
        self.told.append(f"untried: {untried}")


PAPER, GAIN = VisionConfig(method="paper"), ControlsConfig(gain=5)


@pytest.mark.parametrize(
    ("new", "applied"),
    [
        (BayConfig(), []),
        (BayConfig(vision=PAPER), [(PAPER, None)]),
        (BayConfig(camera=CameraConfig(controls=GAIN)), [(VisionConfig(), GAIN)]),
        (BayConfig(vision=PAPER, camera=CameraConfig(controls=GAIN)), [(PAPER, GAIN)]),
        (BayConfig(camera=CameraConfig(controls=GAIN, rotation_deg=90)), []),  # the bay waits for a restart
    ],
)
def test_other_settings_of_vision_and_of_the_cameras_controls_replace_the_vision_process_once(
    new: BayConfig, applied: list[Any]
) -> None:
    vision, control, other = Part(), Part(), cast("Any", Part())
    reloader = Reloader(
        ReloadRequests(lambda: GatewayConfig(bays=(new,))),
        InForce(GatewayConfig(), cast("Any", {"bay1": vision})),
        cast("Any", {"bay1": control}),
        other,
        None,
        other,
        other,
    )
    asyncio.run(reloader._reload())
    assert vision.applied == applied
    assert control.seen == (new if applied else None)
    assert bool(control.told) == bool(applied)


def test_what_is_in_force_as_a_whole_is_another_object_only_where_it_is_another() -> None:
    vision = Part()
    in_force = InForce(GatewayConfig(), cast("Any", {"bay1": vision}))
    first = in_force.whole()
    assert in_force.whole() is first
    vision.settings = PAPER
    assert in_force.whole().bays[0].vision == PAPER
    in_force.config = GatewayConfig(site="south")
    assert (in_force.whole().site, in_force.whole().bays[0].vision) == ("south", PAPER)
