"""The fleet page: all bays heard over MQTT, in one process that can write to none of them (docs/fleet.md)."""
