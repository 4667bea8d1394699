"""Events wait here, on disk, until the other system (a broker, a database) has acknowledged them."""
