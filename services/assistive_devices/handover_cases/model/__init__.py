"""Values of the body, and mechanisms that the controllers of several machines use. Pure."""
