"""Devices behind an interface of their vendor, polled with OAuth 2."""
