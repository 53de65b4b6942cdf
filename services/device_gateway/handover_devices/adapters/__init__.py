"""Adapters: devices that speak another protocol than the gateway's own."""
