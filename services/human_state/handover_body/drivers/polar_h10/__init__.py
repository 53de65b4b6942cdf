"""Polar H10: ECG and acceleration by the Polar measurement data service, and the heart rate service."""
