"""The Arduino with its HC-SR04: line protocol, arrival times, one sensor's session. Pure."""
