"""Sensor drivers: one folder each, with settings, a pure protocol parser, a driver and a simulator."""
