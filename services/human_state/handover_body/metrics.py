"""The metrics of human state; none names a person."""

from prometheus_client import Counter, Gauge, Histogram

SENSORS = Gauge("handover_human_state_sensors", "Sensors of persons that run")
FEATURES = Counter("handover_human_state_features_total", "Values of sensors", ["feature", "status"])
LIMIT_STOPS = Counter("handover_human_state_limit_stops_total", "Stops by the state of a person")
REPORTS = Counter("handover_human_state_limit_reports_total", "Speed limits sent to robots", ["outcome"])
DELAY = Histogram(
    "handover_human_state_feature_delay_seconds",
    "Time from the newest sample of a heart rate to its speed limit",
    buckets=(0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10),
)
REJECTED = Counter("handover_human_state_entities_rejected_total", "Entities that the broker refused")
