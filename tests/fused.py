"""Fusion by itself: its result as the state of a bay in which nothing else decides."""

from dataclasses import replace
from typing import Any

from gateway.config import FusionConfig
from gateway.core import fusion
from gateway.core.state import StateVector, Tick


def step(
    state: StateVector, observation: fusion.Observation, now_ns: int, config: FusionConfig, **more: Any
) -> StateVector:
    fused = fusion.step(
        state,
        observation,
        now_ns,
        config,
        stopped=state.stop,
        monitored=state.visit.monitored,
        max_range_mm=4000.0,  # an HC-SR04's
    )
    return replace(
        state,
        t_ns=fused.t_ns,
        seq=state.seq + 1,
        heartbeat=state.heartbeat + isinstance(observation, Tick),
        vision=fused.vision,
        range=fused.range,
        d=fused.d,
        stop=fused.stop,
        may_move=fused.calm,
        reason=fused.reason,
        z_vision_mm=fused.z_vision_mm,
        memory=fused.memory,
        **more,
    )
