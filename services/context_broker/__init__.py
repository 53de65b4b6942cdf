"""The embedded NGSI-LD broker: the shop floor's shared memory, kept in one process and one SQLite file."""
