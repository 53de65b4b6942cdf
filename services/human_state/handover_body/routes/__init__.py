"""REST and WebSocket routes of human state."""
