"""The Prometheus metrics of the bridge."""

from prometheus_client import Counter, Gauge

RECEIVED = Counter(
    "handover_bridge_messages_received_total", "Messages, changes and requests that a rule received", ["rule"]
)
FORWARDED = Counter(
    "handover_bridge_messages_forwarded_total", "Messages that the other side accepted from a rule", ["rule"]
)
ERRORS = Counter("handover_bridge_errors_total", "Messages that a rule could not forward", ["rule"])
DROPPED = Counter(
    "handover_bridge_messages_dropped_total", "Messages lost against the mapping, by cause", ["rule", "cause"]
)
CONFLATED = Counter(
    "handover_bridge_messages_conflated_total",
    "Messages that newer ones replaced, as the mapping asks",
    ["rule"],
)
PENDING_UPDATES = Gauge("handover_bridge_pending_updates", "Updates of entities that wait for the broker")
BROKER_UNAVAILABLE = Gauge("handover_bridge_broker_unavailable", "1 while the broker does not answer")
ARM_WATCHDOG = Counter(
    "handover_bridge_arm_watchdog_stops_total", "Stops of an arm because its velocity commands ceased"
)
HUMANOID_WATCHDOG = Counter(
    "handover_bridge_humanoid_watchdog_holds_total", "Holds of a humanoid because its commands ceased"
)
CHECKS = Counter(
    "handover_bridge_checks_total", "Checks of the topics and their publishers, one every second"
)
TOPIC_SILENT = Gauge("handover_bridge_topic_silent", "1 while the topic of a rule has no publisher", ["rule"])
