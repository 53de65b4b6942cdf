"""People: their gloves, their commands and their own gestures."""
