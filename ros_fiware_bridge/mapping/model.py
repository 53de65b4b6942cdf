"""The mapping: which topics, services and actions of a ROS graph meet which entities and attributes.

ros_to_ngsild:
  battery:
    topic: /battery_state
    type: sensor_msgs/msg/BatteryState
    entity: Device:amr-1
    attributes:
      batteryLevel: percentage
"""

import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from ros_fiware_bridge.mapping import paths
from ros_fiware_bridge.mapping.part import (
    ActionType,
    MessageType,
    Part,
    PathText,
    QosWord,
    ServiceType,
    TemplateText,
    TopicName,
    TopicPattern,
    short_form,
)
from ros_fiware_bridge.mapping.paths import Path
from ros_fiware_bridge.mapping.templates import Template
from ros_fiware_bridge.mapping.templates import parse as parse_template
from ros_fiware_bridge.mapping.values import AttributeGiven, AttributeName, Condition, DeadBand, SourceGiven

_RULE_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def _rule_name(name: Any) -> str:
    if not _RULE_NAME.fullmatch(str(name)):
        raise ValueError(f'"{name}" is no name of a rule; it is small letters, digits, - and _')
    return str(name)


RuleName = Annotated[str, BeforeValidator(_rule_name)]


class Qos(Part):
    """A quality of service: a named one (`preset`), or one changed in what else is said.

    `match` takes reliability and durability from the publishers of the topic, unless one of them is given.
    """

    preset: QosWord = "match"
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    history: Literal["keep_last", "keep_all"] | None = None
    depth: int | None = Field(None, ge=1, le=10_000)


QosGiven = Annotated[Qos, short_form("preset")]


class EntityTemplate(Part):
    """Which entity a message is about."""

    type: str = Field(min_length=1)
    id: TemplateText


class EntitySelector(Part):
    """Which entities of the broker a rule listens to."""

    type: str = Field(min_length=1)
    id: str | None = None
    id_pattern: str | None = None
    q: str | None = None

    @model_validator(mode="after")
    def _selects_in_one_way(self) -> Self:
        if self.id is not None and self.id_pattern is not None:
            raise ValueError("entities are chosen by `id` or by `id_pattern`, not by both")
        if self.id_pattern is not None:
            try:
                re.compile(self.id_pattern)
            except re.error as error:
                raise ValueError(f"id_pattern is no regular expression: {error}") from None
        return self


def _entity(given: Any) -> Any:
    """Take `Device:ur10-1` for its type and id."""
    if not isinstance(given, str):
        return given
    kind, colon, rest = given.partition(":")
    if kind == "urn":
        parts = given.split(":")
        if len(parts) < 4 or "{" in parts[2]:
            raise ValueError(f'"{given}" does not tell the type; write it as {{type: Device, id: "{given}"}}')
        return {"type": parts[2], "id": given}
    if not colon or not kind or not rest or "{" in kind:
        raise ValueError(
            f'"{given}" is no entity; write Type:id, such as Device:ur10-1 or Device:{{header.frame_id}}, '
            "or {type: …, id: …}"
        )
    return {"type": kind, "id": f"urn:ngsi-ld:{kind}:{{factory}}:{rest}"}


def _selector(given: Any) -> Any:
    given = _entity(given)
    if isinstance(given, dict) and "{" in str(given.get("id", "")).replace("{factory}", ""):
        raise ValueError("entities to listen to are named, not made from a message; id_pattern takes several")
    return given


def _resource(given: Any) -> Any:
    found = _selector(given)
    return parse_template(found["id"]) if isinstance(found, dict) and "id" in found else given


EntityGiven = Annotated[EntityTemplate, BeforeValidator(_entity)]
SelectorGiven = Annotated[EntitySelector, BeforeValidator(_selector)]
Resource = Annotated[Template, BeforeValidator(_resource)]


class Buffer(Part):
    """What is kept while the broker is away or slow: the newest of each entity, or the last so many."""

    keep: int = Field(1, ge=1, le=100_000)


def _moment(given: Any) -> Any:
    return given if given in {"received", "none"} else paths.parse(str(given))


MomentGiven = Annotated[Path | Literal["received", "none"], BeforeValidator(_moment)]


def _buffer(given: Any) -> Any:
    return {"keep": 1} if given == "latest" else given


class AlertFromRos(Part):
    """An Alert that stands while a condition holds."""

    key: TemplateText
    about: EntityGiven
    standing: Condition
    category: TemplateText
    sub_category: TemplateText | None = None
    severity: AttributeGiven | None = None
    description: TemplateText


class RosToNgsild(Part):
    """What is said on a topic becomes attributes of an entity (or an Alert).

    With places, `/{robot}/odom`, the rule is for every topic that fits, and `{robot}` may stand in `entity`.
    """

    topic: TopicPattern
    type: MessageType | None = None
    """The type; may be left out where somebody publishes the topic already."""
    qos: QosGiven = Qos()
    each: PathText | None = None
    """An array of the message: the rule is applied to each of its elements, `status[]`."""
    json_text: tuple[PathText, ...] = ()
    """Fields of text that hold JSON, and are looked into."""
    when: Condition | None = None
    entity: EntityGiven | None = None
    attributes: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    alert: AlertFromRos | None = None
    observed_at: MomentGiven | None = None
    """A time field; `received`; or `none`. Without it the header's stamp, else when it was received."""
    create: bool = True
    """Whether an entity that the broker does not have is made; if not, such a message is refused."""
    every_ms: int = Field(0, ge=0, le=86_400_000)
    """An entity is written at most once in so many milliseconds; 0: as often as it is heard of."""
    on_change: bool = False
    dead_band: Annotated[DeadBand, short_form("absolute")] | None = None
    at_least_every_s: float | None = Field(None, gt=0)
    """With `on_change` or a dead band: written this often even so, as a sign of life."""
    buffer: Annotated[Buffer, BeforeValidator(_buffer)] = Buffer()
    large_arrays: bool = False
    most_elements: int = Field(256, ge=1, le=1_000_000)
    most_entities: int = Field(1000, ge=1, le=100_000)

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if bool(self.attributes) is (self.alert is not None):
            raise ValueError("a rule either writes `attributes` of an `entity` or raises an `alert`")
        if self.attributes and self.entity is None:
            raise ValueError("say which `entity` the attributes belong to, such as Device:ur10-1")
        if self.alert is not None and self.entity is not None:
            raise ValueError("an alert says itself what it is about (`about`); drop `entity`")
        return self


class NgsildToRos(Part):
    """What is written of entities is said on a topic."""

    entity: SelectorGiven
    topic: TemplateText
    """A name; `{id}` in it is the last part of the entity's id, for a topic of each entity's own."""
    type: MessageType
    qos: QosGiven = Qos()
    fields: dict[PathText, SourceGiven] = Field(min_length=1)
    at_start: bool | None = None
    """Whether what the broker holds is said when the bridge starts; without it only where it is latched."""
    every_ms: int = Field(0, ge=0, le=86_400_000)

    @property
    def attributes(self) -> tuple[str, ...]:
        """Return the attributes that it looks at, sorted."""
        return tuple(sorted(set().union(*(source.attributes() for source in self.fields.values()))))


class Change(Part):
    """An attribute of an entity changes (and becomes what `is` says)."""

    entity: SelectorGiven
    attribute: AttributeName
    equals: Any = Field(None, alias="is")


class Asked(Part):
    """By what something is set going: a Task for `resource`, or a change of an attribute (`when`)."""

    task: str | None = Field(None, min_length=1)
    """The operation that the Task asks for, or the last part of its TaskDefinition's id."""
    resource: Resource | None = None
    when: Change | None = None
    outputs: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    """What of the answer is told: outputParameters of the Task, or attributes of the entity."""
    timeout_s: float = Field(10.0, gt=0, le=86_400)

    @model_validator(mode="after")
    def _asked_in_one_way(self) -> Self:
        if (self.task is not None) is (self.when is not None):
            raise ValueError("say one of `task` (with `resource`) and `when`: what sets this going")
        if (self.resource is None) is (self.task is not None):
            raise ValueError("a `task` is for a `resource`, such as Device:gripper-1; and `when` has none")
        return self


class ServiceCall(Asked):
    """A service of the graph is called."""

    service: TopicName
    type: ServiceType
    request: dict[PathText, SourceGiven] = Field(default_factory=dict)
    success: PathText | None = None
    """A field of the answer that must be true, else the Task fails."""
    message: PathText | None = None
    """A field of the answer that says why not."""


class ActionGoal(Asked):
    """A goal is sent to an action of the graph."""

    action: TopicName
    type: ActionType
    goal: dict[PathText, SourceGiven] = Field(default_factory=dict)
    feedback: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    """What of the feedback is told; `progress` from 0 to 1 says how far it is."""
    result_timeout_s: float | None = Field(None, gt=0)
    """How long a goal may take; without it as long as it takes."""
    again: bool = True
    """Whether the goal of a Task is sent again by a bridge that was ended meanwhile; else the Task fails."""
    success: PathText | None = None
    message: PathText | None = None


class TaskAsked(Part):
    """The Task that is made when a node asks for one."""

    definition: TemplateText
    resources: tuple[Resource, ...] = Field(min_length=1)
    description: TemplateText | None = None
    parameters: dict[str, SourceGiven] = Field(default_factory=dict)


class TaskFromRos(Part):
    """A service that the bridge serves: a node of the graph asks for a Task with it."""

    service: TopicName
    type: ServiceType
    task: TaskAsked
    answer: Literal["accepted", "finished"] = "accepted"
    response: dict[PathText, SourceGiven] = Field(default_factory=dict)
    """What is answered, from `id`, `accepted`, `completed`, `status`, `reason` and `outputs`."""
    timeout_s: float = Field(30.0, gt=0, le=86_400)


class Mapping(Part):
    """A whole mapping file."""

    type_paths: tuple[str, ...] = ()
    """Files and folders with .msg, .srv and .action definitions, seen from the mapping file."""
    batch_ms: int = Field(2, ge=0, le=60_000)
    """Batches go to the broker at most so often, in milliseconds."""
    ros_to_ngsild: dict[RuleName, RosToNgsild] = Field(default_factory=dict)
    ngsild_to_ros: dict[RuleName, NgsildToRos] = Field(default_factory=dict)
    services: dict[RuleName, ServiceCall] = Field(default_factory=dict)
    actions: dict[RuleName, ActionGoal] = Field(default_factory=dict)
    tasks_from_ros: dict[RuleName, TaskFromRos] = Field(default_factory=dict)

    def rules(self) -> Iterator[tuple[str, str, Part]]:
        """Yield section, name and rule of each."""
        for section in SECTIONS:
            for name, rule in getattr(self, section).items():
                yield section, name, rule

    @model_validator(mode="after")
    def _each_name_once(self) -> Self:
        seen: dict[str, str] = {}
        for section, name, _ in self.rules():
            if name in seen:
                raise ValueError(
                    f'the rule "{name}" stands in {seen[name]} and in {section}; give one another name'
                )
            seen[name] = section
        return self


SECTIONS = ("ros_to_ngsild", "ngsild_to_ros", "services", "actions", "tasks_from_ros")
