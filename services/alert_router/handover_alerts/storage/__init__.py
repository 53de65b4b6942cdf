"""The database of the alert router."""
