"""/metrics for Prometheus: tables of families (`bays`, `parts`); text and documentation are made from them (`text`).

Names after the conventions of Prometheus and OpenMetrics: base units (seconds, meters, bytes), `_total` for counters.
An unknown value has no sample rather than a wrong one. An enumeration is a state set: the active one is 1, others 0.
"""
