"""Metrics: what the trajectory tool counts for Prometheus."""

from prometheus_client import Counter

TASKS = Counter(
    "handover_trajectory_tool_tasks_total", "Tasks by operation and how they ended", ["operation", "outcome"]
)
OVERRUNS = Counter(
    "handover_trajectory_tool_cycle_overruns_total", "Cycles of control that were missed for being late"
)
MOTION_SECONDS = Counter("handover_trajectory_tool_motion_seconds_total", "Time that robots were in motion")
SCANS = Counter("handover_trajectory_tool_scans_total", "Scans by whether a part was found", ["found"])
DROPPED = Counter(
    "handover_trajectory_tool_joint_states_dropped_total", "Joint states that a slow reader did not get"
)
UNTOLD = Counter(
    "handover_trajectory_tool_device_writes_rejected_total", "Writes of the Device that the broker refused"
)
