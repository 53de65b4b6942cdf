"""Entities, attributes and @contexts as values; parsing, validation, changes and rendering. No I/O."""
