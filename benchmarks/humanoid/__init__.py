"""Whole-body control and its peers."""
