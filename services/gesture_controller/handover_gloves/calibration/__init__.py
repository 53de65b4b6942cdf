"""Calibration: adapts a glove to the hand that wears it."""
