"""The metrics of assistive devices; none names a person."""

from prometheus_client import Counter, Gauge, Histogram

FRACTION = Gauge("handover_assistive_limit_fraction", "The speed limit of a machine, 0 to 1", ["machine"])
STOPS = Counter("handover_assistive_stops_total", "Stops of a machine", ["machine", "cause"])
CYCLES = Histogram(
    "handover_assistive_cycle_seconds",
    "Time between two cycles of a machine",
    buckets=(0.04, 0.05, 0.06, 0.08, 0.1, 0.2, 0.5, 1),
)
REJECTED = Counter("handover_assistive_entities_rejected_total", "Entities that the broker refused")
COMMANDS = Counter("handover_assistive_ros_commands_total", "Commands of machines on ROS", ["outcome"])
