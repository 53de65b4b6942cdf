"""Mbientlab MetaMotionS over Bluetooth LE: acceleration."""
