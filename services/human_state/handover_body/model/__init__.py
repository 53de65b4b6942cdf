"""The values of human state, without input or output."""
