"""Moments kept: entities as they were, and the hits of a query as they were."""
