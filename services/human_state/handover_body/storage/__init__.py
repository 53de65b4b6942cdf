"""The database of human state."""
