"""Temporal evolution of entities: recorded, provided, read and aggregated."""
