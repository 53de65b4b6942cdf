"""REST of the alert router."""
