"""Exercises of a patient with a humanoid: catches, difficulty, sessions and reports; no I/O, no clock."""
