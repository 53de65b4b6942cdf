"""Rules of a mapping, checked against message definitions and compiled; pure functions."""
