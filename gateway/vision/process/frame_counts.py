"""The frames of one bay's camera: how many have a result, were skipped or lost, how many a second. Pure."""

from collections import deque
from dataclasses import dataclass, field, replace

from gateway.core.readings import VisionStats
from gateway.durations import NS_PER_MS, NS_PER_S
from gateway.vision.transport.messages import FrameResult


@dataclass(slots=True)
class FrameCounts:
    """`frames` + `skipped` + `lost` is `last_seq`: what is neither a result nor lost was skipped."""

    stats: VisionStats = field(default_factory=VisionStats)
    last_seq: int = 0  # newest frame that has a result, or never gets one
    _results_ns: deque[int] = field(default_factory=lambda: deque(maxlen=4096))  # within the last second

    def with_result(self, result: FrameResult, now_ns: int) -> VisionStats:
        self.last_seq = result.seq
        self._results_ns.append(now_ns)
        frames = self.stats.frames + 1
        self.stats = replace(
            self.stats,
            frames=frames,
            skipped=result.seq - frames - self.stats.lost,
            rate_hz=self._rate_hz(now_ns),
            latency_ms=max(0, now_ns - min(result.t_capture_ns, result.unchanged_since_ns)) / NS_PER_MS,
        )
        return self.stats

    def process_ended(self, last_seq: int, *, lost: bool) -> None:
        """Every frame up to `last_seq` that has no result is skipped; or `lost`, the one that was worked on."""
        self.last_seq = max(self.last_seq, last_seq)
        lost_frames = self.stats.lost + lost
        self.stats = replace(self.stats, lost=lost_frames, skipped=self.last_seq - self.stats.frames - lost_frames)

    def process_started(self, *, link_was_down: bool) -> None:
        """Another one, in the place of one that had ended."""
        if link_was_down:
            self.stats = replace(self.stats, reopens=self.stats.reopens + 1)
        else:
            self.stats = replace(self.stats, restarts=self.stats.restarts + 1)

    def at_fault(self, now_ns: int) -> VisionStats:
        self.stats = replace(self.stats, rate_hz=self._rate_hz(now_ns))
        return self.stats

    def _rate_hz(self, now_ns: int) -> float:
        while self._results_ns and now_ns - self._results_ns[0] >= NS_PER_S:
            self._results_ns.popleft()
        return float(len(self._results_ns))
