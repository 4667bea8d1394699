"""Distance sensors behind one contract. Pure: contract, conditioning, sensors. IO: ports and threads."""
