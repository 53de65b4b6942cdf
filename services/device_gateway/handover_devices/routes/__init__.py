"""The REST interface: devices, their commands and their history."""
