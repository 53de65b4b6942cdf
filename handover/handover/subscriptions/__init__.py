"""Subscriptions of a component at the broker, and their notifications."""
