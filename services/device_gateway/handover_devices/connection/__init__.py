"""Transports: how devices reach the gateway."""
