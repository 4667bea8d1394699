"""Where states and events are published to, besides Modbus: MQTT, Sparkplug B and PostgreSQL."""
