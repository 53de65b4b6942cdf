"""Seeed MR60BHA1, a 60 GHz radar: presence, movement, distance, breathing and heart rate without contact."""
