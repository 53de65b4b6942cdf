"""Study sessions, and their conditions at the gesture controller."""
