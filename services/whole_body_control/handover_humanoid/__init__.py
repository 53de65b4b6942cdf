"""Whole-body control of humanoids, after CoSiMA: one architecture for any humanoid in simulation.

The parts are layers, lowest first: `model` (what a humanoid is), `robots` (one folder each), and above them
tasks, solvers, motion engines, behaviours and the control cycle.

Nothing here is a safety-rated function, and no driver of a physical humanoid exists.
"""
