"""A red disc by the evidence round its rim: candidates by colour, position by edges, colour as a failed_gate. Pure."""
