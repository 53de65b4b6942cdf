"""Sensomative pressure mat over Bluetooth LE."""
