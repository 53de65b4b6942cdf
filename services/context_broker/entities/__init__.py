"""Entities: what writers say of them, what a change makes of them, what readers get."""
