"""Metrics: what the bridge counts for Prometheus."""

from prometheus_client import Counter, Gauge

HEARD = Counter("handover_ros_bridge_heard_total", "Messages, notifications and requests by rule", ["rule"])
TOLD = Counter("handover_ros_bridge_told_total", "Messages that the other side has taken, by rule", ["rule"])
FAULTS = Counter("handover_ros_bridge_faults_total", "What could not be passed on, by rule", ["rule"])
DROPPED = Counter("handover_ros_bridge_dropped_total", "Messages lost, by rule and cause", ["rule", "cause"])
CONFLATED = Counter(
    "handover_ros_bridge_conflated_total",
    "Messages that gave way to newer ones, as their rule wants it",
    ["rule"],
)
WAITING = Gauge("handover_ros_bridge_waiting", "Updates of entities that wait for the broker")
BROKER_AWAY = Gauge("handover_ros_bridge_broker_away", "1 while the broker does not answer")
SILENT = Gauge("handover_ros_bridge_silent", "1 while nobody speaks on the topic of a rule", ["rule"])
