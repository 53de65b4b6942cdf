"""Corsano bracelet over Bluetooth LE: its activity records."""
