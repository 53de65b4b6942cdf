"""Accuracy tests: how reliably and how quickly the gestures of a person are recognized."""
