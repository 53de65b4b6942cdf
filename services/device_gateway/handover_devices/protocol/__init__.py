"""The protocol of devices: messages, times and rates, without I/O."""
