"""The values of human state in messages of others; used by drivers, which read them, and by the exchange."""
