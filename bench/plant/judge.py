"""What a PLC may be shown at a simulated bay, judged by the simulator's truth. Nothing here asks the gateway's code.

The rules are those of docs/visit.md, docs/registers.md and docs/reaction-time.md. Register addresses and codes are
written down a second time, from docs/registers.md. The truth is computed from the scenario and the moment at which
world time was 0 (`gateway simulate --json`, row `started`), in the judge's process: it goes on when the gateway does
not.

A PLC's outputs follow docs/registers.md: they are on while the newest image says so and its heartbeat has changed
within 0.5 s. Between two polls they stay as they are, so they are judged every 20 ms.
"""

import threading
from collections import Counter, deque
from dataclasses import dataclass, field

from bench.plant.poller import ANSWERED, LOST, Poll
from gateway.config import GatewayConfig
from gateway.sim.scenario import Scenario
from gateway.sim.world import Truth, World
from tests.visit_judge import SENSOR_MM, SENSOR_PX, Row, complaints

SEQ_BEGIN, VERSION, HEARTBEAT, STOP, MAY_MOVE = 0, 1, 2, 4, 5
REASON, VISION_QUALITY, RANGE_QUALITY, D = 6, 7, 8, 9
POSITION, IN_PLACE, MOVED, PHASE, GUIDANCE, SEQ_END = 35, 36, 37, 39, 62, 99
RELEASED_BIT, STARTING_REASON, SILENT_REASON, UNKNOWN_D, MAP_VERSION = 4, 10, 40, 0xFFFF, 3
MOVED_NAMES = {0: "no", 1: "distance", 2: "marker"}
GUIDANCE_NAMES = {
    0: "wait", 1: "forward", 2: "back", 3: "left", 4: "right", 5: "slow", 6: "stop", 7: "ok", 8: "too_far",
    9: "fault", 10: "leave", 11: "drive_up",
}  # fmt: skip

HEARTBEAT_S = 0.5  # docs/registers.md
GRID_S = 0.02
# Latest moment at which an output may still be on that the truth forbids: the ranger's deadline, what its median adds,
# a tick, a poll of 50 ms, the moment of judging (docs/reaction-time.md, "Guaranteed"); the heartbeat's 0.5 s is less.
LATE_S = 0.40 + 0.15 + 0.02 + 0.05 + 0.03
# A gateway without processor time: what it last decided is vouched for 0.25 s longer, then nothing is.
STARVED_LATE_S = LATE_S + 0.25
SETTLE_S = 1.0  # visit.settle_s: in_place needs both sensors for this time
EARLY_S = (
    0.15  # the last image without them was read so much later than it was made, at most: a poll, and a late answer
)
PIECE_S = 5.0  # the rules that look back are applied to so much at least, cut where no truck is near its mark
FAR_MM = 600.0
RECENT = 400
JUST_NOW_S = 1.0
ONCE_S = 2.0  # what goes on is one finding


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that must not be, at a moment of world time."""

    t_s: float
    rule: str
    text: str


@dataclass
class _Latency:
    """How long an output stayed on after the truth forbade it: between two moments at which it was surely so."""

    since_s: float | None = None
    counted: bool = False


@dataclass
class Figures:
    """What was seen of one gateway from its PLC."""

    polls: int = 0
    outcomes: Counter[int] = field(default_factory=Counter)
    judged: int = 0
    crossings: int = 0  # truth went from surely D = 0 to surely D = 1 while the PLC's outputs let the truck move
    visits_in_place: int = 0
    releases: int = 0
    may_move_s: float = 0.0
    truth_clear_s: float = 0.0  # the truck is surely before the mark or on its way out
    late_s: dict[str, list[float]] = field(default_factory=dict)  # by what was played: seconds until MayMove was off


class Judge:
    """Judges the polls of one gateway. Its methods may be called from any thread."""

    def __init__(self, scenario: Scenario, config: GatewayConfig) -> None:
        self.world = World(
            scenario,
            radius_threshold_px=config.bays[0].fusion.radius_threshold_px,
            distance_threshold_mm=config.bays[0].fusion.distance_threshold_mm,
        )
        self.figures = Figures()
        self.findings: list[Finding] = []
        self.last: Poll | None = None
        self.playing = "none"  # what is being done to the gateway, for the figures
        self._played: list[tuple[float, str]] = []  # from which world time on
        self.starved = False  # it has no processor time just now: STARVED_LATE_S applies until it has recovered
        self.recent: deque[Row] = deque(maxlen=RECENT)
        self._lock = threading.RLock()
        self._config = config
        self._start_ns: int | None = None
        self._beat: tuple[int, int] | None = None  # value, ns of its newest change as the PLC saw it
        self._shown_ns = 0
        self._image: tuple[int, ...] = ()
        self._not_good_ns: int | None = None  # newest image, or none at all, without both sensors good
        self._was_in_place = False
        self._rows: list[Row] = []
        self._piece_starved = False
        self._crossing = _Latency()
        self._moved_s = float("-inf")  # when MayMove was last on
        self._told_s: dict[str, float] = {}

    # -- what happens ----------------------------------------------------------------------------------------------

    def gateway_started(self, world_start_ns: int) -> None:
        """Another gateway answers from here on. Its world is the one before, if that began at the same moment."""
        with self._lock:
            if self._start_ns != world_start_ns:
                self.finish()
                self._crossing, self._moved_s = _Latency(), float("-inf")
            self._start_ns = world_start_ns

    def poll(self, poll: Poll) -> None:
        """The PLC's newest poll."""
        with self._lock:
            self._poll(poll)

    def _poll(self, poll: Poll) -> None:
        figures = self.figures
        figures.polls += 1
        figures.outcomes[poll.outcome] += 1
        self._hold(poll.ended_ns)
        self.last = poll
        if poll.outcome != ANSWERED:
            # Nobody knows what was shown; a gateway that was started again must begin anew.
            self._was_in_place = self._was_in_place and poll.outcome != LOST
            return
        self._image_rules(poll)
        beat = poll.words[HEARTBEAT]
        if self._beat is None or beat != self._beat[0]:
            self._beat = (beat, poll.ended_ns)
        self._image = poll.words
        self._row(poll.ended_ns)

    def finish(self) -> None:
        """At the end of a gateway's life: judge what has not been judged yet."""
        with self._lock:
            self._judge_piece()
            self._rows = []

    def healthy(self) -> bool:
        """Do the PLC's newest image and heartbeat say: alive, and both sensors good?"""
        return bool(self.recent) and self.recent[-1].good

    @property
    def world_s(self) -> float | None:
        """World time of the newest judged moment."""
        return self.recent[-1].t_s if self.recent else None

    # -- the PLC's outputs -----------------------------------------------------------------------------------------

    def _hold(self, until_ns: int) -> None:
        """The outputs between two images, up to the moment of a newer one."""
        at_ns = self._shown_ns + round(GRID_S * 1e9)
        while self._shown_ns and at_ns < until_ns:
            self._row(at_ns)
            at_ns += round(GRID_S * 1e9)

    def _row(self, at_ns: int) -> None:
        passed_s = (at_ns - self._shown_ns) / 1e9 if self._shown_ns else 0.0
        self._shown_ns = at_ns
        if self._start_ns is None or not self._image:
            return
        truth = self.world.truth((at_ns - self._start_ns) / 1e9, image_speed=False)
        row = self._outputs(at_ns, truth)
        if row.in_place and self.recent and not self.recent[-1].in_place:
            self.figures.visits_in_place += 1
        if row.released and self.recent and not self.recent[-1].released:
            self.figures.releases += 1
        self.recent.append(row)
        self.figures.judged += 1
        self._lateness(row, passed_s)
        self._rows.append(row)
        if not self._played or self._played[-1][1] != self.playing:
            self._played.append((row.t_s, self.playing))
        self._piece_starved |= self.starved
        settled = not (row.in_place or row.released) and row.moved == "no" and row.z_mm > FAR_MM
        if settled and row.t_s - self._rows[0].t_s > PIECE_S:
            self._judge_piece()
            self._rows = [row]

    def _outputs(self, at_ns: int, truth: Truth) -> Row:
        words = self._image
        alive = (
            words[VERSION] >= MAP_VERSION
            and words[SEQ_BEGIN] == words[SEQ_END]
            and self._beat is not None
            and at_ns - self._beat[1] <= HEARTBEAT_S * 1e9
        )
        stop = not alive or words[STOP] == 1
        return Row(
            truth.t_s,
            stop,
            alive and words[MAY_MOVE] == 1 and words[STOP] == 0,
            alive and words[IN_PLACE] == 1 and words[STOP] == 1 and words[MAY_MOVE] == 0,
            alive and bool(words[POSITION] >> RELEASED_BIT & 1),
            None if words[D] == UNKNOWN_D or not alive else words[D] == 1,
            MOVED_NAMES.get(words[MOVED], "no") if alive else "no",
            GUIDANCE_NAMES.get(words[GUIDANCE], "unknown") if alive else "",
            alive and words[VISION_QUALITY] == 0 and words[RANGE_QUALITY] == 0,
            not alive or words[REASON] == STARTING_REASON,
            alive and words[REASON] == SILENT_REASON,
            truth.distance_mm,
            truth.u_px,
            truth.v_px,
            truth.radius_px,
            truth.speed_mm_s,
            truth.truck,
            truth.marker_visible,
            truth.distance_mm,
        )

    # -- the rules -------------------------------------------------------------------------------------------------

    def _image_rules(self, poll: Poll) -> None:
        """What no single image may say."""
        words = poll.words
        if words[SEQ_BEGIN] != words[SEQ_END]:
            self._found(poll.ended_ns, "torn", f"an image of two states: {words[SEQ_BEGIN]} and {words[SEQ_END]}")
        for address, name in ((STOP, "stop"), (MAY_MOVE, "may_move"), (IN_PLACE, "in_place")):
            if words[address] not in (0, 1):
                self._found(poll.ended_ns, "range", f"{name} = {words[address]}")
        if words[STOP] and words[MAY_MOVE]:
            self._found(poll.ended_ns, "stop and may_move", "both are 1")
        if words[IN_PLACE] and not words[STOP]:
            self._found(poll.ended_ns, "in_place without stop", "in_place 1, stop 0")
        if words[IN_PLACE] and words[MAY_MOVE]:
            self._found(poll.ended_ns, "in_place and may_move", "both are 1")
        released = words[POSITION] >> RELEASED_BIT & 1
        good = words[VISION_QUALITY] == 0 and words[RANGE_QUALITY] == 0
        if words[MAY_MOVE] and not good and not released:
            self._found(poll.ended_ns, "may_move by one sensor", f"qualities {words[VISION_QUALITY:D]}")
        if not good or self._not_good_ns is None:
            self._not_good_ns = poll.ended_ns
        since_s = (poll.ended_ns - self._not_good_ns) / 1e9
        if words[IN_PLACE] and not self._was_in_place and since_s < SETTLE_S - EARLY_S:
            self._found(poll.ended_ns, "in_place not settled", f"both sensors good for {since_s:.2f} s only")
        self._was_in_place = words[IN_PLACE] == 1

    def _lateness(self, row: Row, passed_s: float) -> None:
        """How long MayMove stays on after the truth has surely gone to D = 1 (without a release)."""
        fusion = self._config.bays[0].fusion
        surely_at = row.z_mm <= fusion.distance_threshold_mm - SENSOR_MM
        surely_at &= row.radius_px >= fusion.radius_threshold_px + SENSOR_PX
        surely_off = row.z_mm > fusion.distance_threshold_mm + SENSOR_MM
        if surely_off:
            self.figures.truth_clear_s += passed_s
            self.figures.may_move_s += passed_s * row.may_move
        moves = row.may_move and not row.released
        if not surely_at:
            self._crossing = _Latency()
            self._moved_s = row.t_s if moves else self._moved_s
            return
        crossing = self._crossing
        if crossing.since_s is None:
            crossing.since_s = row.t_s
            # One that did not move on its way in shows nothing.
            crossing.counted = row.t_s - self._moved_s > JUST_NOW_S
            self.figures.crossings += not crossing.counted
        if not crossing.counted and not moves:
            crossing.counted = True
            self.figures.late_s.setdefault(self.playing, []).append(row.t_s - crossing.since_s)

    def _judge_piece(self) -> None:
        """The rules that look at what came before."""
        if not self._rows:
            return
        late_s = STARVED_LATE_S if self._piece_starved else LATE_S
        self._piece_starved = self.starved
        for text in complaints(self._rows, self._config, late_s=late_s):
            moment, _, what = text.partition(": ")
            t_s = float(moment)
            if t_s > self._told_s.get(what, float("-inf")) + ONCE_S:
                self.findings.append(Finding(t_s, "visit", f"{what} (while: {self._playing_at(t_s)})"))
            self._told_s[what] = t_s

    def _playing_at(self, t_s: float) -> str:
        """What was done to the gateway then, and what before it."""
        names = [name for since_s, name in self._played if since_s <= t_s + 0.005]
        return names[-1] if names[-1:] != ["none"] or len(names) < 2 else f"after {names[-2]}"

    def _found(self, at_ns: int, rule: str, text: str) -> None:
        t_s = (at_ns - (self._start_ns or at_ns)) / 1e9
        self.findings.append(Finding(round(t_s, 3), rule, f"{text} (while: {self.playing})"))
