"""Specifications: what Tasks ask for, written down once and looked up when a Task does not say it itself."""
