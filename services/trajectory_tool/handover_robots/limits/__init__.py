"""Limits of commanded motion: what a robot may do, and how fast while people are near or strained.

Nothing here is a safety-rated function. A limit is advisory and only ever lowers the speed.
"""
