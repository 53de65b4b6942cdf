"""The metrics of the alert router."""

from prometheus_client import Counter, Gauge

SENT = Counter("handover_alert_messages_total", "Messages about Alerts", ["channel_type", "outcome"])
WAITING = Gauge("handover_alert_messages_waiting", "Messages about Alerts that wait to be sent")
ACTIVE = Gauge("handover_alert_router_alerts", "Alerts that are followed")
