"""The plan: a whole mapping, checked against the message definitions before anything starts.

Every error is reported with its file and line; the result is ready to run.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath

from handover.distribution import install_command
from handover.errors import UsageError
from handover_ros.errors import AdapterUnavailable, GraphError
from handover_ros.graph.qos import Durability, History, Qos, Reliability
from handover_ros.mapping import model, names
from handover_ros.mapping.document import Document, Fault, InvalidMapping
from handover_ros.mapping.model import (
    ActionGoal,
    EntitySelector,
    NgsildToRos,
    RosRequestRule,
    RosToNgsild,
    ServiceCall,
    TaskFromRos,
)
from handover_ros.mapping.paths import Path
from handover_ros.mapping.templates import Template
from handover_ros.mapping.values import RESOURCE, Attribute, Source
from handover_ros.rules import attributes
from handover_ros.rules.attributes import CompileContext, MadeAttribute
from handover_ros.rules.entity_extractor import EntityExtractor, ErrorScope, ReportError
from handover_ros.rules.json_values import JsonValues
from handover_ros.rules.message_builder import MessageBuilder
from handover_ros.rules.message_schema import InvalidRule, MessageSchema
from handover_ros.types.type_store import TypeStore

TypesOf = Callable[[str], tuple[str, ...]]
"""Returns the types that a topic of the graph has now."""

TASK_ANSWERS = ("id", "accepted", "completed", "status", "reason", "outputs")


@dataclass(frozen=True)
class PlannedRosToNgsild:
    """A rule from ROS to NGSI-LD; `extractor` is None while the type of the topic is unknown.

    With `match` the publishers determine reliability and durability; without publishers `qos` applies.
    """

    name: str
    rule: RosToNgsild
    qos: Qos
    extractor: EntityExtractor | None
    match: bool = False
    pattern: re.Pattern[str] | None = None
    """Matches the topics of the rule, if its topic has placeholders such as `{robot}`."""

    def for_topic(self, plan: "Plan", topic: str, placeholders: Mapping[str, str]) -> "PlannedRosToNgsild":
        """Return the rule for one topic that matches its pattern."""
        assert self.extractor is not None  # noqa: S101 - a pattern has a type
        rule = self.rule.model_copy(update={"topic": topic})
        settings = {**plan.settings, **placeholders}
        made = EntityExtractor(rule, self.extractor.type_name, plan.definitions, settings, lambda *_: None)
        return replace(self, rule=rule, extractor=made, pattern=None)

    def reader_qos(self, publishers: Iterable[Qos]) -> Qos:
        """Return the quality of service of the subscription, given the offers of the publishers."""
        return self.qos.matching(publishers) if self.match else self.qos


@dataclass(frozen=True)
class PlannedNgsildToRos:
    """A rule from NGSI-LD to ROS."""

    name: str
    rule: NgsildToRos
    qos: Qos
    builder: MessageBuilder
    selector: EntitySelector
    at_start: bool


@dataclass(frozen=True)
class PlannedRequest:
    """A rule that calls a service or sends a goal."""

    name: str
    rule: ServiceCall | ActionGoal
    request: MessageBuilder
    outputs: tuple[MadeAttribute, ...]
    feedback: tuple[MadeAttribute, ...]
    resource: str | None
    selector: EntitySelector | None

    @property
    def reads_resource(self) -> bool:
        """Return whether a field is an attribute of the Task's resource: `resource.jointNames`."""
        fields = self.rule.request if isinstance(self.rule, ServiceCall) else self.rule.goal
        return any(RESOURCE in source.attributes() for source in fields.values())


@dataclass(frozen=True)
class PlannedServedService:
    """A rule whose service the bridge serves; a node calls it to request a Task."""

    name: str
    rule: TaskFromRos
    response: MessageBuilder
    resources: tuple[str, ...]


@dataclass
class Plan:
    """The compiled rules of a mapping."""

    document: Document
    definitions: TypeStore
    settings: Mapping[str, str]
    ros_to_ngsild: list[PlannedRosToNgsild] = field(default_factory=list)
    ngsild_to_ros: list[PlannedNgsildToRos] = field(default_factory=list)
    requests: list[PlannedRequest] = field(default_factory=list)
    served_services: list[PlannedServedService] = field(default_factory=list)

    def watched(self) -> frozenset[str]:
        """Return the attributes that rules read from the broker; they need the mark of their origin."""
        names = {name for planned in self.ngsild_to_ros for name in planned.rule.attributes}
        names |= {planned.rule.when.attribute for planned in self.requests if planned.rule.when is not None}
        return frozenset(names)

    def names(self) -> Iterator[str]:
        """Yield the name of every rule."""
        yield from (name for _, name, _ in self.document.mapping.rules())


def type_store(document: Document) -> TypeStore:
    """Return the types that the mapping may use. Raises `InvalidMapping`."""
    try:
        return TypeStore([FilePath(document.folder, path) for path in document.mapping.type_paths])
    except GraphError as error:
        raise InvalidMapping(document.file, [document.fault(("type_paths",), str(error))]) from None


def make(
    document: Document,
    definitions: TypeStore,
    factory: str,
    types_of: TypesOf = lambda _: (),
) -> Plan:
    """Return the plan of a mapping; `types_of` supplies types of topics that the mapping leaves out.

    Raises `InvalidMapping` with every error, `AdapterUnavailable` if a required library is missing.
    """
    maker = _Maker(Plan(document, definitions, {"factory": factory}), types_of)
    try:
        maker.all()
    except ModuleNotFoundError as error:
        raise AdapterUnavailable(
            f"{error.name} is not installed; install the extra: {install_command('ros')}"
        ) from None
    if maker.faults:
        raise InvalidMapping(document.file, sorted(set(maker.faults), key=lambda fault: fault.line))
    return maker.plan


def compile_rule(plan: Plan, rule: RosToNgsild, type_name: str, report: ReportError) -> EntityExtractor:
    """Return a rule compiled for messages of `type_name`. Raises `InvalidRule`, `GraphError`."""
    plan.definitions.sound(type_name)
    return EntityExtractor(rule, type_name, plan.definitions, plan.settings, report)


def qos_of(rule_qos: model.RuleQos) -> Qos:
    """Return the quality of service of a rule."""
    preset = Qos.named("default" if rule_qos.preset == "match" else rule_qos.preset)
    return Qos(
        Reliability(rule_qos.reliability) if rule_qos.reliability else preset.reliability,
        Durability(rule_qos.durability) if rule_qos.durability else preset.durability,
        History(rule_qos.history) if rule_qos.history else preset.history,
        rule_qos.depth or preset.depth,
    )


class _Maker:
    def __init__(self, plan: Plan, types_of: TypesOf) -> None:
        self.plan = plan
        self.faults: list[Fault] = []
        self._types_of = types_of

    def all(self) -> None:
        mapping = self.plan.document.mapping
        for name, topic_rule in mapping.ros_to_ngsild.items():
            with self._rule_scope("ros_to_ngsild", name):
                self.plan.ros_to_ngsild.append(self._topic_rule(name, topic_rule))
        for name, entity_rule in mapping.ngsild_to_ros.items():
            with self._rule_scope("ngsild_to_ros", name):
                self.plan.ngsild_to_ros.append(self._entity_rule(name, entity_rule))
        for name, service in mapping.services.items():
            with self._rule_scope("services", name):
                self.plan.requests.append(self._service(name, service))
        for name, action in mapping.actions.items():
            with self._rule_scope("actions", name):
                self.plan.requests.append(self._action(name, action))
        for name, served in mapping.tasks_from_ros.items():
            with self._rule_scope("tasks_from_ros", name):
                self.plan.served_services.append(self._served_service(name, served))

    def _topic_rule(self, name: str, rule: RosToNgsild) -> PlannedRosToNgsild:
        type_name = rule.type
        placeholders = names.placeholders(rule.topic)
        if placeholders and type_name is None:
            raise InvalidRule(f"the topic {rule.topic} has placeholders; set its type as well (type: …)")
        if type_name is None:
            types = self._types_of(rule.topic)
            if len(types) > 1:
                raise InvalidRule(
                    f"{rule.topic} has the types {' and '.join(types)}; set one of them (type: …)"
                )
            type_name = types[0] if types else None
        sample = replace(self.plan, settings={**self.plan.settings, **dict.fromkeys(placeholders, "x")})
        made = (
            compile_rule(sample, rule, type_name, self._reporter("ros_to_ngsild", name))
            if type_name
            else None
        )
        qos = qos_of(rule.qos)
        if rule.qos.depth is None:  # a reader of less depth would lose messages that the rule keeps
            qos = replace(qos, depth=max(qos.depth, rule.buffer.keep))
        match = rule.qos.preset == "match" and not (rule.qos.reliability or rule.qos.durability)
        pattern = names.matcher(rule.topic) if placeholders else None
        return PlannedRosToNgsild(name, rule, qos, made, match, pattern)

    def _entity_rule(self, name: str, rule: NgsildToRos) -> PlannedNgsildToRos:
        report = self._reporter("ngsild_to_ros", name)
        fields = self._fields(rule.type, rule.fields, _below(report, "fields"))
        with ErrorScope(report, ("topic",)):
            _require_topic(rule.topic, self.plan.settings)
        if not rule.attributes:
            raise InvalidRule(
                "no field is filled from an attribute, so there is no attribute to subscribe to"
            )
        qos = qos_of(rule.qos)
        latched = qos.durability is Durability.TRANSIENT_LOCAL
        at_start = latched if rule.at_start is None else rule.at_start
        return PlannedNgsildToRos(name, rule, qos, fields, self._selector(rule.entity), at_start)

    def _service(self, name: str, rule: ServiceCall) -> PlannedRequest:
        self.plan.definitions.resolve(rule.type, "srv")
        report = self._reporter("services", name)
        request = self._fields(f"{rule.type}_Request", rule.request, _below(report, "request"))
        answer = self._schema(f"{rule.type}_Response")
        self._verdict(rule, answer, report)
        return self._request(
            name, rule, request, self._made(rule.outputs, answer, _below(report, "outputs")), ()
        )

    def _action(self, name: str, rule: ActionGoal) -> PlannedRequest:
        self.plan.definitions.resolve(rule.type, "action")
        report = self._reporter("actions", name)
        goal = self._fields(f"{rule.type}_Goal", rule.goal, _below(report, "goal"))
        result = self._schema(f"{rule.type}_Result")
        self._verdict(rule, result, report)
        outputs = self._made(rule.outputs, result, _below(report, "outputs"))
        feedback = self._schema(f"{rule.type}_Feedback")
        made = self._made(rule.feedback, feedback, _below(report, "feedback"))
        return self._request(name, rule, goal, outputs, made)

    def _request(
        self,
        name: str,
        rule: ServiceCall | ActionGoal,
        request: MessageBuilder,
        outputs: tuple[MadeAttribute, ...],
        feedback: tuple[MadeAttribute, ...],
    ) -> PlannedRequest:
        resource = self._filled(rule.resource) if rule.resource is not None else None
        selector = self._selector(rule.when.entity) if rule.when is not None else None
        self._refuse_two_for_one(rule, resource)
        return PlannedRequest(name, rule, request, outputs, feedback, resource, selector)

    def _served_service(self, name: str, rule: TaskFromRos) -> PlannedServedService:
        self.plan.definitions.resolve(rule.type, "srv")
        report = self._reporter("tasks_from_ros", name)
        asked = self._schema(f"{rule.type}_Request")
        for parameter, source in rule.task.parameters.items():
            with ErrorScope(report, ("task", "parameters", parameter)):
                if source.attribute is not None:
                    asked.target(source.attribute)
        for key, template in (("definition", rule.task.definition), ("description", rule.task.description)):
            with ErrorScope(report, ("task", key)):
                if template is not None:
                    attributes.text(template, asked, self.plan.settings)
        for path, source in rule.response.items():
            with ErrorScope(report, ("response", str(path))):
                root = source.attribute.root if source.attribute is not None else None
                if root is not None and root not in TASK_ANSWERS:
                    raise InvalidRule(f'a response has no "{root}"; it has {", ".join(TASK_ANSWERS)}')
        response = self._fields(f"{rule.type}_Response", rule.response, _below(report, "response"))
        return PlannedServedService(name, rule, response, tuple(map(self._filled, rule.task.resources)))

    def _refuse_two_for_one(self, rule: RosRequestRule, resource: str | None) -> None:
        for other in self.plan.requests:
            if rule.task is not None and (other.rule.task, other.resource) == (rule.task, resource):
                raise InvalidRule(
                    f'the task "{rule.task}" of {resource} is already mapped by the rule "{other.name}"; '
                    "name another task or resource"
                )

    def _verdict(self, rule: ServiceCall | ActionGoal, answer: MessageSchema, report: ReportError) -> None:
        if rule.success is not None:
            with ErrorScope(report, ("success",)):
                if (target := answer.target(rule.success)).type is not None and target.type.base != "bool":
                    raise InvalidRule(
                        f"{rule.success} is {target}; `success` is a field that is true or false"
                    )
        if rule.message is not None:
            with ErrorScope(report, ("message",)):
                answer.target(rule.message)

    def _made(
        self, asked: Mapping[str, Attribute], schema: MessageSchema, report: ReportError
    ) -> tuple[MadeAttribute, ...]:
        values = JsonValues(self.plan.definitions, 10_000, large_arrays=False)
        context = CompileContext(schema, values, self.plan.settings)
        made = []
        for name, attribute in asked.items():
            with ErrorScope(report, (name,)):
                if attribute.sub_attributes:
                    raise InvalidRule(
                        "only attributes that a topic writes have `sub_attributes`; remove them"
                    )
                made.append(attributes.compiled(name, attribute, context))
        return tuple(made)

    def _fields(self, type_name: str, fields: Mapping[Path, Source], report: ReportError) -> MessageBuilder:
        self.plan.definitions.sound(type_name)
        return MessageBuilder(type_name, fields, self.plan.definitions, self.plan.settings, report)

    def _schema(self, type_name: str) -> MessageSchema:
        self.plan.definitions.sound(type_name)
        return MessageSchema(self.plan.definitions, type_name)

    def _selector(self, selector: EntitySelector) -> EntitySelector:
        filled = {
            name: value.replace("{factory}", self.plan.settings["factory"])
            for name in ("id", "id_pattern", "q")
            if (value := getattr(selector, name)) is not None
        }
        return selector.model_copy(update=filled)

    def _filled(self, template: Template) -> str:
        return template.with_settings(self.plan.settings).constant or ""

    def _reporter(self, section: str, name: str) -> ReportError:
        def report(where: tuple[str, ...], why: Exception) -> None:
            self.faults.append(self.plan.document.fault((section, name, *where), str(why)))

        return report

    def _rule_scope(self, section: str, name: str) -> "_RuleErrorScope":
        return _RuleErrorScope(self._reporter(section, name))


class _RuleErrorScope:
    """Reports an error that affects a whole rule, and suppresses it, so that the other rules are checked."""

    def __init__(self, report: ReportError) -> None:
        self._report = report

    def __enter__(self) -> None:
        return None

    def __exit__(self, _: object, error: BaseException | None, __: object) -> bool:
        if isinstance(error, GraphError | InvalidRule | UsageError):
            self._report(("type",) if isinstance(error, GraphError) else (), InvalidRule(str(error)))
            return True
        return False


def _below(report: ReportError, key: str) -> ReportError:
    return lambda where, why: report((key, *where), why)


def _require_topic(template: Template, settings: Mapping[str, str]) -> None:
    for path in template.with_settings(settings).paths:
        if str(path) != "id":
            raise InvalidRule(f'a topic may only contain {{id}}, not "{{{path}}}"')
    sample = "".join(
        part if isinstance(part, str) else "x" for part in template.with_settings(settings).parts
    )
    try:
        names.topic(sample)
    except ValueError as error:
        raise InvalidRule(str(error)) from None
