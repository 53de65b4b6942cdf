"""Calibration: a glove learns the hand that wears it, at the start and while it is worn."""
