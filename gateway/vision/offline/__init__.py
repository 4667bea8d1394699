"""What `gateway evaluate`, `tune` and `calibrate` work with; the gateway at work loads none of it."""
