"""What every component stands on: the NGSI-LD client, the Performer, settings, telemetry, the database.

No word of gloves, robots or processes stands here; the command line, `handover.cli`, is the roof and may
know everyone.
"""
