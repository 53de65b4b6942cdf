"""What a device is, as values: sensors with units, joints with limits, commands."""
