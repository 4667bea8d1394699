"""Durations are whole nanoseconds wherever they are computed with."""

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000
