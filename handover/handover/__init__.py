"""The kit of every component: NGSI-LD client, Performer, settings, telemetry, database and security.

It does not know gloves, robots or processes. Only the command line, `handover_cell`, imports the services.
"""
