"""Outgoing connections: which addresses the broker may connect to, and the HTTP client that does."""
