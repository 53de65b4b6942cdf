"""Gloves on TCP, screens on WebSocket, and the Device entity of each glove in the broker."""
