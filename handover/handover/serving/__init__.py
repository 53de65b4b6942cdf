"""Services as servers: application, process, standby, watchdog, certificate."""
