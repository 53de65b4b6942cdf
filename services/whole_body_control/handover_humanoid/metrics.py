"""The metrics of whole-body control; none names a person."""

from prometheus_client import Counter, Gauge

CYCLE_RUNS = Gauge("handover_humanoid_cycle_running", "1 while the control cycle of the humanoid runs")
CYCLE_ENDS = Counter("handover_humanoid_cycle_ends_total", "Unexpected ends of the control cycle")
FRACTION = Gauge("handover_humanoid_limit_fraction", "The speed limit of the humanoid, 0 to 1")
STOPS = Counter("handover_humanoid_stops_total", "Stops of the humanoid", ["cause"])
INPUTS = Counter("handover_humanoid_inputs_total", "Messages of people who steer or catch", ["outcome"])
REJECTED = Counter("handover_humanoid_entities_rejected_total", "Entities that the broker refused")
LINK_DELAY = Gauge(
    "handover_humanoid_link_delay_seconds",
    "How old the newest wish of the ROS graph was, by the clock of the robot.",
)
