"""The commands of this service, by entry points in `handover.commands`."""
