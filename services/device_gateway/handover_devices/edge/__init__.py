"""A gateway on site that relays its devices to a central gateway over one TLS connection."""
