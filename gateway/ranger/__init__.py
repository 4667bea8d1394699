"""Distance sensors behind one contract. Pure: contract, conditioning, hcsr04. IO: port, service (a thread each)."""
