"""Runs what consent allows: sensors, processing, fusion, limits, and what shows and stores them."""
