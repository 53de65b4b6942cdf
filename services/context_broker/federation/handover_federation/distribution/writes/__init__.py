"""Writes at several sources: the parts of each, where they go, and the response to all of them."""
