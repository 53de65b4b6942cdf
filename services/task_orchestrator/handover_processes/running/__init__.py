"""The running orchestrator: its parts, reconciliation with the broker, offers, events, archive."""
