"""One simulated bay as the command line knows it: its scenario, its world, and world time."""

from gateway.clock import NS_PER_S
from gateway.config import FusionConfig
from gateway.sim.departure import Standing
from gateway.sim.scenario import Scenario
from gateway.sim.world import Truth, World


class Bay:
    """`truth(t_ns)` is what an ideal sensor would see at a time of the gateway's clock."""

    def __init__(
        self,
        name: str,
        unit_id: int,
        scenario: Scenario,
        thresholds: FusionConfig,
        origin_ns: int,
        standing: Standing | None = None,
    ) -> None:
        self.name = name
        self.unit_id = unit_id
        self.scenario = scenario
        self.origin_ns = origin_ns
        self.thresholds = thresholds
        self.standing = standing
        self.world = World(
            scenario,
            radius_threshold_px=thresholds.radius_threshold_px,
            distance_threshold_mm=thresholds.distance_threshold_mm,
            standing=standing,
        )

    def t_s(self, t_ns: int) -> float:
        """World time of an instant; negative before the show begins."""
        return (t_ns - self.origin_ns) / NS_PER_S

    def truth(self, t_ns: int) -> Truth:
        return self.world.truth(self.t_s(t_ns))
