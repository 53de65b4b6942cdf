"""Subscriptions that are forwarded to context sources, and the notifications of these."""
