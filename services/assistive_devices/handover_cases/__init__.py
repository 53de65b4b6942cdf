"""Assistive devices: machines that adapt to the body of a person, with their controllers and simulations."""
