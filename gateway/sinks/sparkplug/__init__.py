"""Sparkplug B 3.0: the gateway as an edge node, each bay as a device. Pure: wire, metrics, node. IO: publisher."""
