"""Endpoints of brokers that are named by their IP address."""

from gateway.sinks.mqtt.broker import parse
from gateway.sinks.mqtt.endpoints import Endpoint
from gateway.sinks.mqtt.lookup import numeric


def at(url: str, rank: int = 0) -> Endpoint:
    broker = parse(url)
    return Endpoint(broker, numeric(*broker.reached_at)[0], rank)
