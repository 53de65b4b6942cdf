"""Motion of robots: planning, limits, control by people, drivers."""
