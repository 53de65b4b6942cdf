"""Features of several sensors become the state of one person, by quality."""
