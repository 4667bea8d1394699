"""Child processes of the gateway: how one is started, talked to, killed and reaped. What they do stands elsewhere."""
