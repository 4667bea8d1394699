"""/metrics for Prometheus: tables of families (`bays`, `parts`); text and documentation come from them (`text`).

Names after the conventions of Prometheus and OpenMetrics: base units (seconds, meters, bytes), `_total` for counters.
What is not known has no sample rather than a wrong one. An enumeration is a state set: what holds is 1, the rest 0.
"""
