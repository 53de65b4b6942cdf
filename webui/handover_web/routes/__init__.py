"""REST and WebSockets of the page server."""
