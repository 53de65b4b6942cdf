"""Composed gestures: both hands at once, or two gestures of one hand in turn."""
