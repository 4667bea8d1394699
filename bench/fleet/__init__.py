"""A hundred gateways without cameras on three brokers: renewed certificates and faults, in one command."""
