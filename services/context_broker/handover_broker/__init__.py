"""The embedded NGSI-LD broker: one process with one SQLite file, or a PostgreSQL database."""
