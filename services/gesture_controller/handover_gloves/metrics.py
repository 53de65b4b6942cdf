"""The Prometheus metrics of the gesture controller."""

from prometheus_client import Counter, Gauge

FRAMES_RECEIVED = Counter("handover_gesture_controller_frames_received_total", "Frames received from gloves")
LINES_DROPPED = Counter(
    "handover_gesture_controller_lines_dropped_total", "Invalid lines of gloves, by reason", ["reason"]
)
CONNECTIONS_REFUSED = Counter(
    "handover_gesture_controller_connections_refused_total",
    "Connections of gloves that were refused or ended, by reason",
    ["reason"],
)
GLOVES_CONNECTED = Gauge("handover_gesture_controller_gloves_connected", "Connected gloves")
TASKS_ANSWERED = Counter(
    "handover_gesture_controller_tasks_answered_total",
    "Tasks answered by a person, by gesture or screen and by outcome",
    ["by", "outcome"],
)
COMMANDS_SENT = Counter(
    "handover_gesture_controller_commands_sent_total", "Commands sent without a Task, filtering being off"
)
WRONG_GESTURES = Counter(
    "handover_gesture_controller_wrong_gestures_total", "Held gestures that the Task did not ask for"
)
GLOVE_SILENCES = Counter(
    "handover_gesture_controller_glove_silences_total", "Gloves that stopped sending during a Task"
)
BROKER_WRITES_REFUSED = Counter(
    "handover_gesture_controller_broker_writes_refused_total", "Writes that the broker refused"
)
