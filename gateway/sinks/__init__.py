"""Where states and events are published to, besides Modbus: MQTT and Sparkplug B."""
