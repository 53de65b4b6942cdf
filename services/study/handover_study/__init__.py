"""The study service: usability studies that compare personal and predefined gestures."""
