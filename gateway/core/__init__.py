"""The pure core: observations in; state vector, decision and events out. No IO, no clock, no concurrency."""
