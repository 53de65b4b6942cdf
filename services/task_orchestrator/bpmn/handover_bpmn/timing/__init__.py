"""When something is due: timers, and a queue of moments."""
