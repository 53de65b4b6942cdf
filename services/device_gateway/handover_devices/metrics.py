"""The metrics of the device gateway."""

from prometheus_client import Counter, Gauge, Histogram

CONNECTED = Gauge("handover_devices_connected", "Devices with a connection")
CONNECTIONS_REFUSED = Counter(
    "handover_device_connections_refused_total", "Connections of devices that were refused or ended", ["kind"]
)
MESSAGES = Counter("handover_device_messages_total", "Messages of devices that were accepted", ["type"])
MESSAGES_REFUSED = Counter(
    "handover_device_messages_refused_total", "Messages of devices that were refused", ["code"]
)
RELAYED = Counter(
    "handover_device_relayed_total",
    "Messages that edges have relayed: stored, repeated (known already), refused, live, late",
    ["outcome"],
)
OUTBOX_BYTES = Gauge("handover_edge_outbox_bytes", "Bytes that wait at this edge for the centre")
OUTBOX_ROWS = Gauge("handover_edge_outbox_messages", "Messages that wait at this edge for the centre")
OUTBOX_DROPPED = Gauge(
    "handover_edge_outbox_dropped", "Messages that this edge has dropped since its first start: it was full"
)
EDGE_COMMANDS = Counter(
    "handover_edge_commands_total",
    "Commands and velocities at this edge: passedOn, refused, velocityDropped, stopped, cancelled",
    ["outcome"],
)
LINK_UP = Gauge("handover_edge_link_up", "Whether this edge is connected with the centre")
VALUES = Counter("handover_device_values_total", "Values of devices that were stored")
COMMIT = Histogram(
    "handover_device_commit_seconds",
    "Time of a group commit of the history",
    buckets=(0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10),
)
BACKLOG = Gauge("handover_device_history_backlog", "Rows of the history that wait for a commit")
COMMANDS = Counter("handover_device_commands_total", "Commands that ended", ["state"])
REPORTS = Counter("handover_device_reports_total", "Devices written to the broker", ["outcome"])
ADAPTER_CONNECTED = Gauge(
    "handover_device_adapter_connected", "Whether an adapter reaches its devices or server", ["adapter"]
)
REPLICAS = Gauge(
    "handover_device_replicas", "Other replicas of the gateway that relay to this one, the leader"
)
LEADS = Gauge("handover_device_gateway_leads", "Whether this replica of the gateway leads")
ANOMALIES = Counter("handover_device_anomalies_total", "Alarms of rules that went on or off", ["change"])
WATCHES = Gauge("handover_device_watches", "Values of devices that rules watch")
PROCESSES = Counter("handover_device_processes_total", "Processes that alarms were to start", ["outcome"])
DRIVE_STOP_BEGIN = Histogram(
    "handover_device_drive_stop_begin_seconds",
    "From a release of the dead-man control, or the loss of its messages, to the stop message to the robot",
    buckets=(0.001, 0.002, 0.004, 0.008, 0.015, 0.04, 0.1, 0.3),
)
