"""Simulated sensors on a simulated person, with faults on request."""
