"""Case studies: a machine with the body of a simulated person, in one cell."""
