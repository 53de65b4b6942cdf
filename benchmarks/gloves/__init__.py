"""Recognition of gestures."""
