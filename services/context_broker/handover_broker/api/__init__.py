"""The HTTP server: protocol, application, health and metrics."""
