"""Reading audit logs: the routes of a log, and the logs of all services of a data directory."""
