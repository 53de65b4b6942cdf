"""The device gateway: devices and robots join over TCP and TLS, with JSON lines."""
