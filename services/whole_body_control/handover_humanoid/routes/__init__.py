"""REST and WebSockets of whole-body control."""
