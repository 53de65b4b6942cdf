"""Machines that run: their cycles, history, trials and entities."""
