"""A plugin of the broker: context source registrations, distributed operations, entity maps and snapshots.

The broker finds it by the entry points `federation` and `snapshots` in `handover.broker_plugins`, and works
without it. The interfaces are in `handover_broker.extensions`.
"""
