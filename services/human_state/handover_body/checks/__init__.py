"""Checks of what a sensor sends, each in one place: times, rates and silence, then values."""
