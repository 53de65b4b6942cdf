"""The alert router: sends Alerts to people by mail, webhook and messenger."""
