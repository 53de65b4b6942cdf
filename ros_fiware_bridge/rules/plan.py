"""The plan: a whole mapping checked against the message definitions, before anything starts.

Every mistake is told with its file and line; what comes out is ready to run.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath

from handover.errors import UsageError
from ros_fiware_bridge.errors import AdapterUnavailable, GraphError
from ros_fiware_bridge.graph.qos import Durability, History, Qos, Reliability
from ros_fiware_bridge.mapping import model, names
from ros_fiware_bridge.mapping.document import Document, Fault, WrongMapping
from ros_fiware_bridge.mapping.model import (
    ActionGoal,
    Asked,
    EntitySelector,
    NgsildToRos,
    RosToNgsild,
    ServiceCall,
    TaskFromRos,
)
from ros_fiware_bridge.mapping.paths import Path
from ros_fiware_bridge.mapping.templates import Template
from ros_fiware_bridge.mapping.values import Attribute, Source
from ros_fiware_bridge.rules import attributes
from ros_fiware_bridge.rules.attributes import Ground, MadeAttribute
from ros_fiware_bridge.rules.definitions import Anatomy, WrongRule
from ros_fiware_bridge.rules.inward import Inward
from ros_fiware_bridge.rules.json_values import JsonValues
from ros_fiware_bridge.rules.outward import Outward, Say, Telling
from ros_fiware_bridge.types.type_store import TypeStore

TypesOf = Callable[[str], tuple[str, ...]]
"""Tells the types that a topic of the graph has now."""

TASK_ANSWERS = ("id", "accepted", "completed", "status", "reason", "outputs")


@dataclass(frozen=True)
class PlannedOutward:
    """A rule from ROS to NGSI-LD; `outward` is None while nobody has told the topic's type.

    With `match` reliability and durability are those of the publishers, and of `qos` while there is none.
    """

    name: str
    rule: RosToNgsild
    qos: Qos
    outward: Outward | None
    match: bool = False
    pattern: re.Pattern[str] | None = None
    """Matches the topics of the rule, where its topic has places such as `{robot}`."""

    def at(self, plan: "Plan", topic: str, places: Mapping[str, str]) -> "PlannedOutward":
        """Return the rule for one of the topics that fit its pattern."""
        assert self.outward is not None  # noqa: S101 - a pattern has a type
        rule = self.rule.model_copy(update={"topic": topic})
        settings = {**plan.settings, **places}
        made = Outward(rule, self.outward.type_name, plan.definitions, settings, lambda *_: None)
        return replace(self, rule=rule, outward=made, pattern=None)

    def reader_qos(self, publishers: Iterable[Qos]) -> Qos:
        """Return the quality of service to read with, given what the publishers offer."""
        return self.qos.matching(publishers) if self.match else self.qos


@dataclass(frozen=True)
class PlannedInward:
    """A rule from NGSI-LD to ROS."""

    name: str
    rule: NgsildToRos
    qos: Qos
    inward: Inward
    selector: EntitySelector
    at_start: bool


@dataclass(frozen=True)
class PlannedAsk:
    """A service that is called, or an action that a goal is sent to."""

    name: str
    rule: ServiceCall | ActionGoal
    request: Inward
    outputs: tuple[MadeAttribute, ...]
    feedback: tuple[MadeAttribute, ...]
    resource: str | None
    selector: EntitySelector | None


@dataclass(frozen=True)
class PlannedOffer:
    """A service that is served, with which a node asks for a Task."""

    name: str
    rule: TaskFromRos
    response: Inward
    resources: tuple[str, ...]


@dataclass
class Plan:
    """What runs."""

    document: Document
    definitions: TypeStore
    settings: Mapping[str, str]
    outward: list[PlannedOutward] = field(default_factory=list)
    inward: list[PlannedInward] = field(default_factory=list)
    asks: list[PlannedAsk] = field(default_factory=list)
    offers: list[PlannedOffer] = field(default_factory=list)

    def watched(self) -> frozenset[str]:
        """Return the attributes that are listened to, which need the mark of where they came from."""
        names = {name for planned in self.inward for name in planned.rule.attributes}
        names |= {planned.rule.when.attribute for planned in self.asks if planned.rule.when is not None}
        return frozenset(names)

    def names(self) -> Iterator[str]:
        """Yield the name of every rule."""
        yield from (name for _, name, _ in self.document.mapping.rules())


def type_store(document: Document) -> TypeStore:
    """Return the types that the mapping may use. Raises `WrongMapping`."""
    try:
        return TypeStore([FilePath(document.folder, path) for path in document.mapping.type_paths])
    except GraphError as error:
        raise WrongMapping(document.file, [document.fault(("type_paths",), str(error))]) from None


def make(
    document: Document,
    definitions: TypeStore,
    factory: str,
    types_of: TypesOf = lambda _: (),
) -> Plan:
    """Return the plan of a mapping; `types_of` helps out where a rule does not say the type of its topic.

    Raises `WrongMapping` with every mistake, `AdapterUnavailable` without the libraries it takes.
    """
    maker = _Maker(Plan(document, definitions, {"factory": factory}), types_of)
    try:
        maker.all()
    except ModuleNotFoundError as error:
        raise AdapterUnavailable(
            f"{error.name} is not installed; install the extra: pip install 'handover[ros]'"
        ) from None
    if maker.faults:
        raise WrongMapping(document.file, sorted(set(maker.faults), key=lambda fault: fault.line))
    return maker.plan


def outward(plan: Plan, rule: RosToNgsild, type_name: str, say: Say) -> Outward:
    """Return a rule made ready for messages of `type_name`. Raises `WrongRule`, `GraphError`."""
    plan.definitions.sound(type_name)
    return Outward(rule, type_name, plan.definitions, plan.settings, say)


def qos_of(given: model.Qos) -> Qos:
    """Return the quality of service that a rule asks for."""
    preset = Qos.named("default" if given.preset == "match" else given.preset)
    return Qos(
        Reliability(given.reliability) if given.reliability else preset.reliability,
        Durability(given.durability) if given.durability else preset.durability,
        History(given.history) if given.history else preset.history,
        given.depth or preset.depth,
    )


class _Maker:
    def __init__(self, plan: Plan, types_of: TypesOf) -> None:
        self.plan = plan
        self.faults: list[Fault] = []
        self._types_of = types_of

    def all(self) -> None:
        mapping = self.plan.document.mapping
        for name, outgoing in mapping.ros_to_ngsild.items():
            with self._at("ros_to_ngsild", name):
                self.plan.outward.append(self._outward(name, outgoing))
        for name, incoming in mapping.ngsild_to_ros.items():
            with self._at("ngsild_to_ros", name):
                self.plan.inward.append(self._inward(name, incoming))
        for name, service in mapping.services.items():
            with self._at("services", name):
                self.plan.asks.append(self._service(name, service))
        for name, action in mapping.actions.items():
            with self._at("actions", name):
                self.plan.asks.append(self._action(name, action))
        for name, offer in mapping.tasks_from_ros.items():
            with self._at("tasks_from_ros", name):
                self.plan.offers.append(self._offer(name, offer))

    def _outward(self, name: str, rule: RosToNgsild) -> PlannedOutward:
        type_name = rule.type
        places = names.places(rule.topic)
        if places and type_name is None:
            raise WrongRule(f"the topic {rule.topic} has places, so say which type it has (type: …)")
        if type_name is None:
            told = self._types_of(rule.topic)
            if len(told) > 1:
                raise WrongRule(f"{rule.topic} has the types {' and '.join(told)}; say which (type: …)")
            type_name = told[0] if told else None
        sample = replace(self.plan, settings={**self.plan.settings, **dict.fromkeys(places, "x")})
        made = outward(sample, rule, type_name, self._say("ros_to_ngsild", name)) if type_name else None
        qos = qos_of(rule.qos)
        if rule.qos.depth is None:  # what the rule keeps, a reader that keeps less would lose before
            qos = replace(qos, depth=max(qos.depth, rule.buffer.keep))
        match = rule.qos.preset == "match" and not (rule.qos.reliability or rule.qos.durability)
        pattern = names.matcher(rule.topic) if places else None
        return PlannedOutward(name, rule, qos, made, match, pattern)

    def _inward(self, name: str, rule: NgsildToRos) -> PlannedInward:
        say = self._say("ngsild_to_ros", name)
        fields = self._fields(rule.type, rule.fields, _below(say, "fields"))
        with Telling(say, ("topic",)):
            _require_topic(rule.topic, self.plan.settings)
        if not rule.attributes:
            raise WrongRule("no field is filled from an attribute, so there is nothing to listen to")
        qos = qos_of(rule.qos)
        latched = qos.durability is Durability.TRANSIENT_LOCAL
        at_start = latched if rule.at_start is None else rule.at_start
        return PlannedInward(name, rule, qos, fields, self._selector(rule.entity), at_start)

    def _service(self, name: str, rule: ServiceCall) -> PlannedAsk:
        self.plan.definitions.resolve(rule.type, "srv")
        say = self._say("services", name)
        request = self._fields(f"{rule.type}_Request", rule.request, _below(say, "request"))
        answer = self._anatomy(f"{rule.type}_Response")
        self._verdict(rule, answer, say)
        return self._ask(name, rule, request, self._made(rule.outputs, answer, _below(say, "outputs")), ())

    def _action(self, name: str, rule: ActionGoal) -> PlannedAsk:
        self.plan.definitions.resolve(rule.type, "action")
        say = self._say("actions", name)
        goal = self._fields(f"{rule.type}_Goal", rule.goal, _below(say, "goal"))
        result = self._anatomy(f"{rule.type}_Result")
        self._verdict(rule, result, say)
        outputs = self._made(rule.outputs, result, _below(say, "outputs"))
        told = self._anatomy(f"{rule.type}_Feedback")
        return self._ask(name, rule, goal, outputs, self._made(rule.feedback, told, _below(say, "feedback")))

    def _ask(
        self,
        name: str,
        rule: ServiceCall | ActionGoal,
        request: Inward,
        outputs: tuple[MadeAttribute, ...],
        feedback: tuple[MadeAttribute, ...],
    ) -> PlannedAsk:
        resource = self._filled(rule.resource) if rule.resource is not None else None
        selector = self._selector(rule.when.entity) if rule.when is not None else None
        self._refuse_two_for_one(rule, resource)
        return PlannedAsk(name, rule, request, outputs, feedback, resource, selector)

    def _offer(self, name: str, rule: TaskFromRos) -> PlannedOffer:
        self.plan.definitions.resolve(rule.type, "srv")
        say = self._say("tasks_from_ros", name)
        asked = self._anatomy(f"{rule.type}_Request")
        for parameter, source in rule.task.parameters.items():
            with Telling(say, ("task", "parameters", parameter)):
                if source.attribute is not None:
                    asked.leads(source.attribute)
        for key, template in (("definition", rule.task.definition), ("description", rule.task.description)):
            with Telling(say, ("task", key)):
                if template is not None:
                    attributes.text(template, asked, self.plan.settings)
        for path, source in rule.response.items():
            with Telling(say, ("response", str(path))):
                root = source.attribute.root if source.attribute is not None else None
                if root is not None and root not in TASK_ANSWERS:
                    raise WrongRule(f'there is no "{root}" to answer; there are {", ".join(TASK_ANSWERS)}')
        response = self._fields(f"{rule.type}_Response", rule.response, _below(say, "response"))
        return PlannedOffer(name, rule, response, tuple(map(self._filled, rule.task.resources)))

    def _refuse_two_for_one(self, rule: Asked, resource: str | None) -> None:
        for other in self.plan.asks:
            if rule.task is not None and (other.rule.task, other.resource) == (rule.task, resource):
                raise WrongRule(
                    f'the task "{rule.task}" of {resource} is done by the rule "{other.name}" already; '
                    "name another task or resource"
                )

    def _verdict(self, rule: ServiceCall | ActionGoal, answer: Anatomy, say: Say) -> None:
        if rule.success is not None:
            with Telling(say, ("success",)):
                if (found := answer.leads(rule.success)).type is not None and found.type.base != "bool":
                    raise WrongRule(f"{rule.success} is {found}; `success` is a field that is true or false")
        if rule.message is not None:
            with Telling(say, ("message",)):
                answer.leads(rule.message)

    def _made(self, asked: Mapping[str, Attribute], anatomy: Anatomy, say: Say) -> tuple[MadeAttribute, ...]:
        values = JsonValues(self.plan.definitions, 10_000, large_arrays=False)
        ground = Ground(anatomy, values, self.plan.settings)
        made = []
        for name, attribute in asked.items():
            with Telling(say, (name,)):
                made.append(attributes.compiled(name, attribute, ground))
        return tuple(made)

    def _fields(self, type_name: str, fields: Mapping[Path, Source], say: Say) -> Inward:
        self.plan.definitions.sound(type_name)
        return Inward(type_name, fields, self.plan.definitions, self.plan.settings, say)

    def _anatomy(self, type_name: str) -> Anatomy:
        self.plan.definitions.sound(type_name)
        return Anatomy(self.plan.definitions, type_name)

    def _selector(self, selector: EntitySelector) -> EntitySelector:
        filled = {
            name: value.replace("{factory}", self.plan.settings["factory"])
            for name in ("id", "id_pattern", "q")
            if (value := getattr(selector, name)) is not None
        }
        return selector.model_copy(update=filled)

    def _filled(self, template: Template) -> str:
        return template.with_settings(self.plan.settings).constant or ""

    def _say(self, section: str, name: str) -> Say:
        def say(where: tuple[str, ...], why: Exception) -> None:
            self.faults.append(self.plan.document.fault((section, name, *where), str(why)))

        return say

    def _at(self, section: str, name: str) -> "_Gathering":
        return _Gathering(self._say(section, name))


class _Gathering:
    """Tells of what makes a whole rule impossible, and lets the others be looked at."""

    def __init__(self, say: Say) -> None:
        self._say = say

    def __enter__(self) -> None:
        return None

    def __exit__(self, _: object, error: BaseException | None, __: object) -> bool:
        if isinstance(error, GraphError | WrongRule | UsageError):
            self._say(("type",) if isinstance(error, GraphError) else (), WrongRule(str(error)))
            return True
        return False


def _below(say: Say, key: str) -> Say:
    return lambda where, why: say((key, *where), why)


def _require_topic(template: Template, settings: Mapping[str, str]) -> None:
    for path in template.with_settings(settings).paths:
        if str(path) != "id":
            raise WrongRule(f'a topic is filled from {{id}} alone, not from "{{{path}}}"')
    sample = "".join(
        part if isinstance(part, str) else "x" for part in template.with_settings(settings).parts
    )
    try:
        names.topic(sample)
    except ValueError as error:
        raise WrongRule(str(error)) from None
