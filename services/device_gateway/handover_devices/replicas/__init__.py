"""Several gateways on one PostgreSQL database: each has connections of devices, and one of them leads."""
