"""REST of the gesture controller, by subject."""
