"""The messages between this server and the page, as typed dictionaries.

They are the contract of `WS /api/live` and of the server's own REST. `python -m handover_web.types` generates
the TypeScript types of the page from their JSON Schema. The views of gloves, robots, processes and
definitions are those of the services, which this server forwards; an integration test validates them.

A topic has one value, and only the newest counts; `null` means that it was deleted. Events are not coalesced:
their `seq` increases by one, and the page fills a gap with `GET /api/events?after=`.
"""

from typing import Any, Literal, NotRequired

from pydantic import ConfigDict
from typing_extensions import TypedDict

from handover_web.live.tasklist_view import Status, TasklistView

DeviceState = Literal["ok", "idle", "busy", "paused", "charging", "outOfBattery", "forMaintenance", "error"]
Severity = Literal["informational", "low", "medium", "high", "critical"]
Finger = Literal["thumb", "index", "middle", "ring", "little"]
Side = Literal["left", "right"]
Outcome = Literal["ok", "notGood", "problem"]
AlertPriority = Literal["low", "medium", "high", "critical"]
AlertStateName = Literal["new", "acknowledged", "shelved", "returnedToNormal"]
CalibrationStep = Literal["fist", "open", "gesture"]


class LastMessage(TypedDict):
    """The last message received from a service."""

    at: str
    text: str


class ServiceHealth(TypedDict):
    """A row of the topic `services`: `rates` are per second; `url` is for callers who may read everything."""

    name: str
    url: str | None
    state: Literal["up", "degraded", "down"]
    detail: str | None
    since: str
    rates: dict[str, float]
    lastMessage: LastMessage | None


class Message(TypedDict):
    """A message of the gesture controller: the page translates `key` with `values`; `text` is in English."""

    key: str
    values: dict[str, str | float | list[str]]
    text: str


class GesturePart(TypedDict):
    """A part of a composed gesture; `hand` is null if one hand shows the parts in sequence."""

    gesture: str
    code: str
    hand: Side | None
    state: Literal["done", "held", "now", "next"]


class AnswerOption(TypedDict):
    """An answer other than `ok`; `gesture` is null if only the screen offers it."""

    outcome: Outcome
    gesture: str | None
    code: str | None


class GloveTask(TypedDict):
    """The Task of a glove; `code` has five finger states, thumb first: 0 straight, 1 between, 2 bent."""

    id: str
    description: str
    gesture: str
    code: str
    commandId: int | None
    parts: NotRequired[list[GesturePart]]
    answers: NotRequired[list[AnswerOption]]
    needsPin: NotRequired[bool]
    status: Status


class Hold(TypedDict):
    """The gesture held now; `spent`: it has counted already and must be released before it counts again."""

    gesture: str | None
    heldMs: float
    announceMs: float
    confirmMs: float
    spent: bool
    outcome: NotRequired[Outcome | None]


class GivenAnswer(TypedDict):
    """The last answer given with a glove or on its screen."""

    task: str
    gesture: str | None
    by: Literal["gesture", "screen"]
    operator: str | None
    outcome: NotRequired[Outcome]
    note: NotRequired[str | None]


class Threshold(TypedDict):
    """The thresholds of a finger: straight above `upper`, bent below `lower`; the reverse if `inverted`."""

    upper: float
    lower: float
    inverted: NotRequired[bool]


class Recognizer(TypedDict):
    """The recognizer in use; `missing` is what prevents another one."""

    name: str
    missing: str | None


class SensorWarning(TypedDict):
    """A finger with an unreliable sensor."""

    finger: Finger
    why: Literal["dead", "saturated", "wrongWay", "smallSpan", "noisy"]
    advice: str


class CalibrationOutcome(TypedDict):
    """How a guided calibration ended."""

    applied: bool
    problem: str | None
    sensorWarnings: list[SensorWarning]


class GuideView(TypedDict):
    """A guided calibration; `restless` are the fingers that moved in the last second."""

    step: CalibrationStep
    steps: list[CalibrationStep]
    phase: Literal["countdown", "capture", "done", "givenUp", "interrupted"]
    gesture: str | None
    code: str
    remainingMs: float
    restless: list[Finger]
    message: Message
    outcome: CalibrationOutcome | None


class RequestedGesture(TypedDict):
    """A gesture that an accuracy test asks for."""

    gesture: str
    code: str


class LastTrial(TypedDict):
    """The last trial of an accuracy test."""

    asked: str
    outcome: Literal["right", "corrected", "missed"]
    first: str
    recognizedMs: float | None


class AccuracyTest(TypedDict):
    """A running accuracy test; `round` counts from 1."""

    id: str
    phase: Literal["break", "rest", "asked", "noted", "interrupted", "stopped", "finished"]
    reason: str
    asked: RequestedGesture | None
    done: int
    trials: int
    round: int
    rounds: int
    heldMs: float
    holdMs: float
    askedForMs: float
    limitMs: float
    last: LastTrial | None


class GloveView(TypedDict):
    """Topic `glove/<name>`: a glove, from the gesture controller."""

    glove: str
    hand: Side
    person: str | None
    connected: bool
    deviceState: DeviceState
    battery: float | None
    task: GloveTask | None
    message: Message
    hold: Hold
    bend: list[float] | None
    states: str | None
    gesture: str | None
    differs: list[Finger]
    answered: GivenAnswer | None
    testing: bool
    filtering: bool
    paused: bool
    lost: bool
    thresholds: dict[Finger, Threshold]
    warning: NotRequired[Message | None]
    recognizer: NotRequired[Recognizer]
    calibrationNeeded: NotRequired[str | None]
    calibration: NotRequired[GuideView | None]
    accuracyTest: NotRequired[AccuracyTest | None]
    frames: int
    dropped: int
    droppedBy: dict[str, int]
    rate_hz: float


class JointState(TypedDict):
    """Topic `robot/<id>/joints`, for subscribed pages, up to 30 times a second; rad, rad/s (or m, m/s)."""

    stamp: float
    name: list[str]
    position: list[float]
    velocity: list[float]


class ToolPose(TypedDict):
    """The pose of the tool: m and a quaternion."""

    position: list[float]
    orientation: list[float]


class Gripper(TypedDict):
    """The gripper of a robot."""

    closed: bool
    holds: str | None
    interrupted: Literal["grip", "release"] | None
    """The act that a crash of the trajectory tool has interrupted: its outcome is unknown."""


class WaitingPerson(TypedDict):
    """A person who waits for the control of a robot; `id` is that of the session."""

    id: str
    name: str


class RobotView(TypedDict):
    """Topic `robot/<id>`: a robot, from the trajectory tool; another `revision` has another description.

    `scene` is the digest of the scene around it; `awaitsConfirmation`: its hand-over waits for a person.
    """

    id: str
    device: str
    model: str
    revision: str
    scene: str
    deviceState: DeviceState
    joints: JointState
    toolPose: ToolPose
    gripper: Gripper
    task: str | None
    awaitsConfirmation: bool
    operation: str | None
    progress: float | None
    remainingS: float | None
    controlledBy: str | None
    waitingForControl: list[WaitingPerson]


class AcknowledgementView(TypedDict):
    """Who acknowledged an Alert, and when."""

    by: str
    at: str


class AlertView(TypedDict):
    """Topic `alert/<urn>`: an active Alert, or one of the last fifty that returned to normal.

    The page translates `description` by its code and parameters.
    """

    id: str
    category: str
    subCategory: str | None
    severity: Severity
    priority: AlertPriority
    state: AlertStateName
    stateAt: str | None
    description: str
    descriptionCode: NotRequired[str | None]
    descriptionParameters: NotRequired[dict[str, Any]]
    source: str
    dateIssued: str
    validTo: str | None
    shelvedUntil: str | None
    shelvedBy: str | None
    acknowledged: AcknowledgementView | None


class DeviceView(TypedDict):
    """Topic `device/<urn>`: a Device entity in the broker."""

    id: str
    category: list[str]
    deviceState: DeviceState | None
    batteryLevel: float | None
    observedAt: str | None
    value: Any


class DeviceValue(TypedDict):
    """The latest value of a sensor or joint: seconds since 1970, the unit as UN/CEFACT code."""

    value: float
    t: float
    unit: str | None
    stale: bool


class DeviceSensor(TypedDict):
    """A sensor of a registered device, which may not have sent a value yet."""

    name: str
    unit: str | None
    minimum: float | None
    maximum: float | None


class RegisteredDeviceView(TypedDict):
    """Topic `registeredDevice/<urn>`: a device of the device gateway, for pages that subscribe to all."""

    name: str
    entity: str
    kind: str
    title: str
    connected: bool
    hasToken: bool
    state: DeviceState | None
    batteryLevel: float | None
    seenAt: float | None
    updatedAt: float
    location: str | None
    sensors: list[DeviceSensor]
    values: dict[str, DeviceValue]


class RegisteredDevicesView(TypedDict):
    """Topic `registeredDevices`: whether the device gateway answers, for subscribed pages."""

    isCurrent: bool


class OperatorView(TypedDict):
    """Topic `operator`: the simulated operator."""

    running: bool
    glove: str
    detail: str | None


class CellView(TypedDict):
    """Topic `cell`: the factory, the version, and the location of the emergency stop if it is configured."""

    factory: str
    version: str
    emergencyStop: NotRequired[str]


class CellSummary(TypedDict):
    """A cell on the broker, of `GET /api/webui/cells`; a silent one has not said that it stops."""

    name: str
    tenant: str
    state: Literal["running", "stopped", "silent"]
    lastSeen: str
    runningProcesses: int
    unfinishedTasks: int
    incidents: int
    completedLastHour: int
    failedLastHour: int
    alerts: int


class PeopleView(TypedDict):
    """Topic `people`: a revision of the list of people, for subscribed pages."""

    revision: str


class CommentsView(TypedDict):
    """Topic `comments`: how many comments pages have sent lately, by the id of the Task or process."""

    counts: dict[str, int]


class LiveEvent(TypedDict):
    """An event: the page translates `key` with `values`; `text` is in English."""

    seq: int
    at: str
    level: Literal["info", "attention", "stop"]
    source: str
    key: str
    values: dict[str, Any]
    text: str


class Batch(TypedDict):
    """A message from the server to a page. Topics that a snapshot does not contain do not exist."""

    type: Literal["snapshot", "batch"]
    at: str
    topics: dict[str, Any]
    events: list[LiveEvent]


class SubscribeMessage(TypedDict):
    """A message from a page to the server: the on-demand topics that the page shows now."""

    type: Literal["subscribe"]
    topics: list[str]


class ProblemDetails(TypedDict):
    """An error response (RFC 7807); services add further members."""

    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]

    title: str
    detail: str
    status: int


class AlertProblem(ProblemDetails):
    """The error of an action on one Alert."""

    alert: str


class AlertsResult(TypedDict):
    """The result of an action on Alerts."""

    done: list[str]
    failed: list[AlertProblem]


VIEWS = (
    ServiceHealth, GloveView, RobotView, JointState, TasklistView, AlertView,
    DeviceView, RegisteredDeviceView, RegisteredDevicesView, OperatorView, CellView, PeopleView, CommentsView,
    LiveEvent, Batch, SubscribeMessage,
    ProblemDetails, AlertsResult, CellSummary,
)  # fmt: skip
"""The types for which TypeScript is generated, with all types that they contain."""

ALIASES = {
    "Status": Status,
    "DeviceState": DeviceState,
    "Severity": Severity,
    "Finger": Finger,
    "Side": Side,
    "Outcome": Outcome,
    "AlertPriority": AlertPriority,
    "AlertState": AlertStateName,
    "CalibrationStep": CalibrationStep,
}
"""Unions of strings that get a name of their own in TypeScript."""

TOPICS: dict[str, Any] = {
    "services": list[ServiceHealth],
    "operator": OperatorView,
    "cell": CellView,
    "people": PeopleView,
    "comments": CommentsView,
    "glove/": GloveView,
    "robot/": RobotView,
    "tasklist/": TasklistView,
    "alert/": AlertView,
    "device/": DeviceView,
    "registeredDevices": RegisteredDevicesView,
    "registeredDevice/": RegisteredDeviceView,
}
"""The type of each topic; a name that ends in "/" is a family."""

ORCHESTRATOR_TOPICS = {"process/": "ProcessView", "definition/": "DefinitionView"}
"""Topics that are responses of the orchestrator, passed on as they are, with the names of their schemas.

`handover_web.service_types` generates their types from its OpenAPI document.
"""


def type_of_topic(topic: str) -> Any:
    """Return the type of a topic of this server; raises `KeyError` for others."""
    if topic.startswith("robot/") and topic.endswith("/joints"):
        return JointState
    family, slash, _ = topic.partition("/")
    return TOPICS[family + slash]
