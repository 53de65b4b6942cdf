"""Channels, routes, and which messages about an Alert are due."""
