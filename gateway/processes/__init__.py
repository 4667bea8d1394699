"""Child processes of the gateway: how one is started, exchanged messages with, killed and reaped."""
