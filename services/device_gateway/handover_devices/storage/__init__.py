"""The database: devices, their commands, all messages, and values as time series."""
