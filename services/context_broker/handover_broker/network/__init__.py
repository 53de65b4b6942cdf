"""Outgoing connections: the policy for addresses, and the HTTP client."""
