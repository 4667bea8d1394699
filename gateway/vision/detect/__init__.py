"""The detection methods: a frame in, a detection out. Pure."""
