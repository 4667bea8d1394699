"""`gateway update`: another version of the gateway on this machine, proven in operation, or back by itself.

`prepare` does everything up to the switch, for a person at a terminal. `watcher` waits for free bays, switches, proves
and returns; it runs as the unit loading-gateway-update, which systemd starts again after a power cut. Both run the old
version's code. All that they do to the machine goes through `machine.Machine`.
"""
