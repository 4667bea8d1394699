"""Events wait here, on disk, until a broker has acknowledged them."""
