"""Metrics: what the controller counts for Prometheus."""

from prometheus_client import Counter, Gauge

FRAMES = Counter("handover_gesture_controller_frames_total", "Frames taken from gloves")
DROPPED = Counter(
    "handover_gesture_controller_dropped_total", "Lines of gloves that were no frame, by reason", ["reason"]
)
REFUSED = Counter(
    "handover_gesture_controller_refused_total",
    "Connections that were refused or ended, by reason",
    ["reason"],
)
CONNECTED = Gauge("handover_gesture_controller_gloves_connected", "Gloves that are connected")
CONFIRMATIONS = Counter(
    "handover_gesture_controller_confirmations_total",
    "Tasks that a person answered, by how and with which outcome",
    ["by", "outcome"],
)
COMMANDS = Counter(
    "handover_gesture_controller_commands_total", "Commands sent without a Task, filtering being off"
)
WRONG_GESTURES = Counter(
    "handover_gesture_controller_wrong_gestures_total", "Gestures held that the Task did not ask for"
)
SILENCES = Counter(
    "handover_gesture_controller_silences_total", "Gloves that went silent in the middle of a Task"
)
UNTOLD = Counter(
    "handover_gesture_controller_refused_writes_total",
    "Writes that the broker refused, and that were given up",
)
