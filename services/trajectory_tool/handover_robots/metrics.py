"""The metrics of the trajectory tool."""

from prometheus_client import Counter, Gauge, Histogram

TASKS = Counter(
    "handover_trajectory_tool_tasks_total", "Tasks by operation and outcome", ["operation", "outcome"]
)
OVERRUNS = Counter(
    "handover_trajectory_tool_cycle_overruns_total", "Control cycles that were skipped because they were late"
)
MOTION_SECONDS = Counter(
    "handover_trajectory_tool_motion_seconds_total", "Time in which robots were in motion"
)
SCANS = Counter("handover_trajectory_tool_scans_total", "Scans, by whether a part was found", ["found"])
DROPPED = Counter(
    "handover_trajectory_tool_joint_states_dropped_total", "Joint states that were not sent to a slow client"
)
SCENE_WRITES_REJECTED = Counter(
    "handover_trajectory_tool_scene_writes_rejected_total", "Writes of the scene that the broker rejected"
)
SCENE_CHANGES = Counter("handover_trajectory_tool_scene_changes_total", "Changes of the scene at run time")
DEVICE_WRITES_REJECTED = Counter(
    "handover_trajectory_tool_device_writes_rejected_total", "Writes of the Device that the broker rejected"
)
SIMULATED_SECONDS = Counter(
    "handover_trajectory_tool_simulated_seconds_total", "Time that the physics simulation has simulated"
)
SIMULATION_CPU_SECONDS = Counter(
    "handover_trajectory_tool_simulation_cpu_seconds_total",
    "CPU time of the physics simulation; simulated time over it is the headroom over real time",
)
ALLOWED_PACE = Gauge(
    "handover_trajectory_tool_allowed_speed_ratio",
    "The fraction of its speed that a robot may use",
    ["robot"],
)
CONTROL_INPUTS = Counter(
    "handover_trajectory_tool_control_inputs_total",
    "Inputs of people who control a robot, by outcome",
    ["outcome"],
)
CONTROL_LATENCY = Histogram(
    "handover_trajectory_tool_control_latency_seconds",
    "From the arrival of the input that begins a motion to its first command",
    buckets=(0.001, 0.002, 0.004, 0.008, 0.015, 0.04, 0.1, 0.3),
)
CONTROL_STOP_BEGIN = Histogram(
    "handover_trajectory_tool_control_stop_begin_seconds",
    "From a release of the dead-man control, or the loss of its messages, to the begin of the stop",
    buckets=(0.001, 0.002, 0.004, 0.008, 0.015, 0.04, 0.1, 0.3),
)
CONTROL_STOP = Histogram(
    "handover_trajectory_tool_control_stop_seconds",
    "From a release of the dead-man control, or the loss of its messages, to the rest of the robot",
    buckets=(0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0),
)
LIMIT_REPORTS = Counter(
    "handover_trajectory_tool_limit_reports_total",
    "Reports of speed limits and people, by kind and outcome: accepted, refused, dropped",
    ["kind", "outcome"],
)
LIMIT_STOPS = Counter(
    "handover_trajectory_tool_limit_stops_total", "Times that a limit stopped a robot, by rule", ["rule"]
)
