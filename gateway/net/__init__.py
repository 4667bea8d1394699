"""What every server and client of the network shares."""
