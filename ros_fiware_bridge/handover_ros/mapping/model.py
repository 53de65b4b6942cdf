"""The model of a mapping file: how topics, services and actions correspond to entities and attributes.

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

from handover_ros.mapping import paths
from handover_ros.mapping.part import (
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
from handover_ros.mapping.paths import Path
from handover_ros.mapping.templates import Template
from handover_ros.mapping.templates import parse as parse_template
from handover_ros.mapping.values import AttributeGiven, AttributeName, Condition, DeadBand, SourceGiven

_RULE_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def _rule_name(name: Any) -> str:
    if not _RULE_NAME.fullmatch(str(name)):
        raise ValueError(f'"{name}" is not a rule name; use a-z, 0-9, - and _')
    return str(name)


RuleName = Annotated[str, BeforeValidator(_rule_name)]


class RuleQos(Part):
    """A quality of service: a named one (`preset`), with changes by the other keys.

    `match` takes reliability and durability from the publishers of the topic, unless the rule sets one of
    them.
    """

    preset: QosWord = "match"
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    history: Literal["keep_last", "keep_all"] | None = None
    depth: int | None = Field(None, ge=1, le=10_000)


QosGiven = Annotated[RuleQos, short_form("preset")]


class EntityTemplate(Part):
    """The entity that a message concerns."""

    type: str = Field(min_length=1)
    id: TemplateText


class EntitySelector(Part):
    """The entities of the broker that a rule reads."""

    type: str = Field(min_length=1)
    id: str | None = None
    id_pattern: str | None = None
    q: str | None = None

    @model_validator(mode="after")
    def _selects_in_one_way(self) -> Self:
        if self.id is not None and self.id_pattern is not None:
            raise ValueError("select entities by `id` or by `id_pattern`, not by both")
        if self.id_pattern is not None:
            try:
                re.compile(self.id_pattern)
            except re.error as error:
                raise ValueError(f"id_pattern is not a regular expression: {error}") from None
        return self


def _entity(written: Any) -> Any:
    """Expand `Device:ur10-1` to its type and id."""
    if not isinstance(written, str):
        return written
    kind, colon, rest = written.partition(":")
    if kind == "urn":
        parts = written.split(":")
        if len(parts) < 4 or "{" in parts[2]:
            raise ValueError(
                f'"{written}" does not contain the type; write it as {{type: Device, id: "{written}"}}'
            )
        return {"type": parts[2], "id": written}
    if not colon or not kind or not rest or "{" in kind:
        raise ValueError(
            f'"{written}" is not an entity; write Type:id, such as Device:ur10-1 or '
            "Device:{header.frame_id}, or {type: …, id: …}"
        )
    return {"type": kind, "id": f"urn:ngsi-ld:{kind}:{{factory}}:{rest}"}


def _selector(written: Any) -> Any:
    written = _entity(written)
    if isinstance(written, dict) and "{" in str(written.get("id", "")).replace("{factory}", ""):
        raise ValueError("the id of an entity to read must be constant; id_pattern selects several entities")
    return written


def _resource(written: Any) -> Any:
    selector = _selector(written)
    return parse_template(selector["id"]) if isinstance(selector, dict) and "id" in selector else written


EntityGiven = Annotated[EntityTemplate, BeforeValidator(_entity)]
SelectorGiven = Annotated[EntitySelector, BeforeValidator(_selector)]
Resource = Annotated[Template, BeforeValidator(_resource)]


class Buffer(Part):
    """What is kept of each entity while the broker is unavailable or slow: the newest, or the last `keep`."""

    keep: int = Field(1, ge=1, le=100_000)


def _moment(written: Any) -> Any:
    return written if written in {"received", "none"} else paths.parse(str(written))


MomentGiven = Annotated[Path | Literal["received", "none"], BeforeValidator(_moment)]


def _buffer(written: Any) -> Any:
    return {"keep": 1} if written == "latest" else written


class AlertFromRos(Part):
    """An Alert that is active while a condition holds."""

    key: TemplateText
    about: EntityGiven
    active: Condition
    category: TemplateText
    sub_category: TemplateText | None = None
    severity: AttributeGiven | None = None
    description: TemplateText


class RosToNgsild(Part):
    """Writes the messages of a topic to attributes of an entity, or raises an Alert.

    With placeholders, `/{robot}/odom`, the rule applies to every matching topic; `entity` may contain
    `{robot}`.
    """

    topic: TopicPattern
    type: MessageType | None = None
    """May be left out if a node publishes the topic already."""
    qos: QosGiven = RuleQos()
    each: PathText | None = None
    """An array of the message: the rule applies to each of its elements, `status[]`."""
    json_text: tuple[PathText, ...] = ()
    """Text fields that contain JSON; paths may lead into them."""
    when: Condition | None = None
    entity: EntityGiven | None = None
    attributes: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    alert: AlertFromRos | None = None
    observed_at: MomentGiven | None = None
    """A time field; `received`; or `none`. Default: the header's stamp, else the time of receipt."""
    create: bool = True
    """Whether a missing entity is created; otherwise such a message is refused."""
    every_ms: int = Field(0, ge=0, le=86_400_000)
    """Minimum time in milliseconds between two writes of an entity; 0: no limit."""
    on_change: bool = False
    dead_band: Annotated[DeadBand, short_form("absolute")] | None = None
    at_least_every_s: float | None = Field(None, gt=0)
    """With `on_change` or a dead band: the maximum time between two writes, as a sign of life."""
    buffer: Annotated[Buffer, BeforeValidator(_buffer)] = Buffer()
    large_arrays: bool = False
    max_elements: int = Field(256, ge=1, le=1_000_000)
    max_entities: int = Field(1000, ge=1, le=100_000)

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if bool(self.attributes) is (self.alert is not None):
            raise ValueError("a rule either writes `attributes` of an `entity` or raises an `alert`")
        if self.attributes and self.entity is None:
            raise ValueError("`attributes` need an `entity`, such as Device:ur10-1")
        if self.alert is not None and self.entity is not None:
            raise ValueError("an alert names its entity itself (`about`); remove `entity`")
        return self


class NgsildToRos(Part):
    """Publishes changes of entities on a topic."""

    entity: SelectorGiven
    topic: TemplateText
    """A name; `{id}` is the last part of the entity's id, for one topic per entity."""
    type: MessageType
    qos: QosGiven = RuleQos()
    fields: dict[PathText, SourceGiven] = Field(min_length=1)
    at_start: bool | None = None
    """Whether the state in the broker is published at the start; by default only on latched topics."""
    every_ms: int = Field(0, ge=0, le=86_400_000)
    every_value: bool = False
    """Publish the values of notifications as they are, without reading the entity again: none is skipped."""

    @property
    def attributes(self) -> tuple[str, ...]:
        """Return the attributes that the rule reads, sorted."""
        return tuple(sorted(set().union(*(source.attributes() for source in self.fields.values()))))


class Change(Part):
    """A change of an attribute, optionally to the value `is`."""

    entity: SelectorGiven
    attribute: AttributeName
    equals: Any = Field(None, alias="is")


class RosRequestRule(Part):
    """A request to the graph, triggered by a Task for `resource` or by a change of an attribute (`when`)."""

    task: str | None = Field(None, min_length=1)
    """The operation of the Task, or the last part of its TaskDefinition's id."""
    resource: Resource | None = None
    when: Change | None = None
    outputs: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    """The parts of the response to write: outputParameters of the Task, or attributes of the entity."""
    timeout_s: float = Field(10.0, gt=0, le=86_400)
    again: bool = False
    """Whether the request may be sent again when nobody knows whether it was carried out (no answer, or a
    restart of the bridge): its Task then fails like any other, or is performed again. Otherwise the outcome
    is unknown, and a person decides."""

    @model_validator(mode="after")
    def _asked_in_one_way(self) -> Self:
        if (self.task is not None) is (self.when is not None):
            raise ValueError("set one of `task` (with `resource`) and `when`: the trigger of the request")
        if (self.resource is None) is (self.task is not None):
            raise ValueError("`task` needs a `resource`, such as Device:gripper-1; `when` has none")
        return self


class ServiceCall(RosRequestRule):
    """Calls a service of the graph."""

    service: TopicName
    type: ServiceType
    request: dict[PathText, SourceGiven] = Field(default_factory=dict)
    success: PathText | None = None
    """A field of the response that must be true; otherwise the Task fails."""
    message: PathText | None = None
    """A field of the response with the reason of a failure."""


class ActionGoal(RosRequestRule):
    """Sends a goal to an action of the graph."""

    action: TopicName
    type: ActionType
    goal: dict[PathText, SourceGiven] = Field(default_factory=dict)
    feedback: dict[AttributeName, AttributeGiven] = Field(default_factory=dict)
    """The parts of the feedback to write; `progress` ranges from 0 to 1."""
    result_timeout_s: float | None = Field(None, gt=0)
    """Maximum duration of a goal; no limit by default."""
    success: PathText | None = None
    message: PathText | None = None


class RequestedTask(Part):
    """The Task that is created when a node requests it."""

    definition: TemplateText
    resources: tuple[Resource, ...] = Field(min_length=1)
    description: TemplateText | None = None
    parameters: dict[str, SourceGiven] = Field(default_factory=dict)


class TaskFromRos(Part):
    """A service of the bridge that a node calls to request a Task."""

    service: TopicName
    type: ServiceType
    task: RequestedTask
    answer: Literal["accepted", "finished"] = "accepted"
    response: dict[PathText, SourceGiven] = Field(default_factory=dict)
    """The response, from `id`, `accepted`, `completed`, `status`, `reason` and `outputs`."""
    timeout_s: float = Field(30.0, gt=0, le=86_400)


class Mapping(Part):
    """A whole mapping file."""

    type_paths: tuple[str, ...] = ()
    """Files and folders with .msg, .srv and .action definitions, relative to the mapping file."""
    batch_ms: int = Field(2, ge=0, le=60_000)
    """Minimum time in milliseconds between two requests to the broker."""
    ros_to_ngsild: dict[RuleName, RosToNgsild] = Field(default_factory=dict)
    ngsild_to_ros: dict[RuleName, NgsildToRos] = Field(default_factory=dict)
    services: dict[RuleName, ServiceCall] = Field(default_factory=dict)
    actions: dict[RuleName, ActionGoal] = Field(default_factory=dict)
    tasks_from_ros: dict[RuleName, TaskFromRos] = Field(default_factory=dict)

    def rules(self) -> Iterator[tuple[str, str, Part]]:
        """Yield section, name and rule of every rule."""
        for section in SECTIONS:
            for name, rule in getattr(self, section).items():
                yield section, name, rule

    @model_validator(mode="after")
    def _each_name_once(self) -> Self:
        seen: dict[str, str] = {}
        for section, name, _ in self.rules():
            if name in seen:
                raise ValueError(f'the rule "{name}" is in {seen[name]} and in {section}; rename one of them')
            seen[name] = section
        return self


SECTIONS = ("ros_to_ngsild", "ngsild_to_ros", "services", "actions", "tasks_from_ros")
