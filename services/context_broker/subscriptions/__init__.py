"""Subscriptions: who is told of which changes, and how a notification gets there."""
