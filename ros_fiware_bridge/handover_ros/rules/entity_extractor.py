"""Extracts the states of entities from a message of the ROS graph, attribute by attribute.

An error in one attribute (NaN, an index beyond the end) leaves out that attribute alone, and is reported.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import orjson

from handover.errors import HandoverError
from handover_datamodels.times import iso
from handover_ros.mapping import paths
from handover_ros.mapping.model import AlertFromRos, EntityTemplate, RosToNgsild
from handover_ros.mapping.paths import Path
from handover_ros.mapping.values import Condition
from handover_ros.rules import attributes
from handover_ros.rules.attributes import CompileContext, MadeAttribute
from handover_ros.rules.json_values import JsonValues
from handover_ros.rules.message_schema import Definitions, InvalidRule, MessageSchema

MESSAGE_ERRORS = (HandoverError, ValueError, TypeError, ArithmeticError, LookupError)
"""The errors that a message may cause; they are counted and end nothing."""
Settings = Mapping[str, str]
"""The values of placeholders that no message fills, such as `factory`."""
ReportError = Callable[[tuple[str, ...], InvalidRule], None]
"""Called with the place in a rule that cannot work, and the reason."""
Holds = Callable[[Any], bool]
STAMP = paths.parse("header.stamp")
MIN_STAMP_S = 1e9
"""Of 2001: before it there was no ROS, so an earlier stamp is simulated, or of a clock that was never set."""


@dataclass(frozen=True, slots=True)
class EntityState:
    """The state of an entity by a rule: `values` for comparison, `attributes` as NGSI-LD."""

    entity_id: str
    entity_type: str
    values: Mapping[str, Any]
    attributes: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class AlertState:
    """Whether the Alert `key` is active; `about` is the entity that it concerns."""

    key: str
    about: str
    active: bool
    category: str
    description: str
    sub_category: str | None = None
    severity: str = "medium"


@dataclass(slots=True)
class Extraction:
    """The result of one message."""

    entities: list[EntityState] = field(default_factory=list)
    alerts: list[AlertState] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    is_simulated: bool = False
    """Whether the stamp is of simulated time, and the time of reception was used."""


class EntityExtractor:
    """A compiled rule from ROS to NGSI-LD; each part that cannot work is passed to `report`.

    Raises `InvalidRule` if no part of the rule can work.
    """

    def __init__(
        self,
        rule: RosToNgsild,
        type_name: str,
        definitions: Definitions,
        settings: Settings,
        report: ReportError,
    ) -> None:
        self.rule = rule
        self.type_name = type_name
        self._settings = settings
        self._schema = MessageSchema(definitions, type_name, rule.each, rule.json_text)
        values = JsonValues(definitions, rule.max_elements, large_arrays=rule.large_arrays)
        self._context = CompileContext(self._schema, values, settings)
        self._report = report
        self._when: Holds | None = None
        self._attributes: tuple[MadeAttribute, ...] = ()
        self._id: Callable[[Any], str] | None = None
        self._alert: Callable[[Any], AlertState] | None = None
        self._stamp: Callable[[Any], Any] | None = None
        with ErrorScope(report, ("when",)):
            self._when = compile_condition(rule.when, self._schema)
        with ErrorScope(report, ("observed_at",)):
            self._stamp = self._observed(rule.observed_at)
        if rule.entity is not None:
            with ErrorScope(report, ("entity",)):
                self._id = attributes.entity_id(rule.entity.id, self._schema, self._settings)
        self._attributes = tuple(self._compiled())
        if rule.alert is not None:
            with ErrorScope(report, ("alert",)):
                self._alert = self._compiled_alert(rule.alert)
        self.fields = self._schema.fields
        """The fields that the rule reads of a message."""
        self.constant_entity = self._is_about_one()
        """Whether every message concerns the same entity, so that it is known without decoding a message."""

    @property
    def attributes(self) -> tuple[MadeAttribute, ...]:
        """Return the attributes that the rule writes."""
        return self._attributes

    def extract(
        self, message: dict[str, Any], received_at_s: float, *, is_simulated: bool = False
    ) -> Extraction:
        """Return the states and Alerts of `message` (its `fields` are enough); raises nothing.

        Where `is_simulated`, and for a stamp that is simulated by itself, the time of reception is used.
        """
        extraction = Extraction(is_simulated=is_simulated)
        try:
            message = self._with_json_read(message)
            observed_at = self._observed_at(message, received_at_s, extraction)
            scopes = list(self._scopes(message))
        except MESSAGE_ERRORS as error:
            extraction.errors.append(_described(error))
            return extraction
        for scope in scopes:
            try:
                if self._when is None or self._when(scope):
                    self._extract(scope, observed_at, extraction)
            except MESSAGE_ERRORS as error:
                extraction.errors.append(_described(error))
        return extraction

    def _is_about_one(self) -> bool:
        entity = self.rule.entity
        return (
            self.rule.each is None
            and self._when is None
            and entity is not None
            and entity.id.with_settings(self._settings).constant is not None
        )

    def _extract(self, scope: Any, observed_at: str | None, extraction: Extraction) -> None:
        if self._alert is not None:
            extraction.alerts.append(self._alert(scope))
        if self._id is None or self.rule.entity is None:
            return
        entity_id = self._id(scope)
        values: dict[str, Any] = {}
        written: dict[str, Mapping[str, Any]] = {}
        for attribute in self._attributes:
            try:
                value = attribute.make(scope)
                if value is None:
                    continue  # NGSI-LD has no attribute without a value
            except MESSAGE_ERRORS as error:
                extraction.errors.append(f"{attribute.name}: {_described(error)}")
                continue
            values[attribute.name] = value
            written[attribute.name] = {
                **attribute.written(value, observed_at),
                **self._parts(attribute, scope, values, extraction),
            }
        if written:
            extraction.entities.append(EntityState(entity_id, self.rule.entity.type, values, written))

    def _parts(
        self, attribute: MadeAttribute, scope: Any, values: dict[str, Any], extraction: Extraction
    ) -> dict[str, Any]:
        """Return the sub-attributes; `values` gets each as `attribute.part`, so that its changes count."""
        written: dict[str, Any] = {}
        for part in attribute.parts:
            try:
                value = part.make(scope)
            except MESSAGE_ERRORS as error:
                extraction.errors.append(f"{attribute.name}.{part.name}: {_described(error)}")
                continue
            if value is not None:
                values[f"{attribute.name}.{part.name}"] = value
                written[part.name] = part.written(value, None)
        return written

    def _scopes(self, message: dict[str, Any]) -> Iterator[Any]:
        if self.rule.each is None:
            yield message
            return
        for element in paths.getter(self.rule.each)(message):
            yield message, element

    def _with_json_read(self, message: dict[str, Any]) -> dict[str, Any]:
        for path in self.rule.json_text:
            text = paths.getter(path)(message)
            try:
                read = orjson.loads(text)
            except orjson.JSONDecodeError as error:
                raise ValueError(f"{path} holds no JSON: {error}; it begins with {text[:40]!r}") from None
            message = _replaced(message, [str(step).removeprefix(".") for step in path.steps], read)
        return message

    def _observed(self, asked: Any) -> Callable[[Any], Any] | None:
        if asked in {"received", "none"}:
            return None
        path: Path = STAMP if asked is None else asked
        if asked is None and not self._schema.has_stamp():
            return None
        self._schema.require_time(path)
        return paths.getter(path)

    def _observed_at(self, message: Any, received_at_s: float, extraction: Extraction) -> str | None:
        if self.rule.observed_at == "none":
            return None
        if self._stamp is not None:
            stamp = self._stamp(message)
            seconds = stamp["sec"] + stamp["nanosec"] * 1e-9
            extraction.is_simulated |= 0 < seconds < MIN_STAMP_S
            if stamp["sec"] > 0 and not extraction.is_simulated:
                try:
                    return iso(datetime.fromtimestamp(seconds, UTC))
                except (ValueError, OverflowError, OSError):
                    extraction.errors.append(
                        f"the stamp {seconds} is not a valid time; the time of receipt is used"
                    )
        return iso(datetime.fromtimestamp(received_at_s, UTC))

    def _compiled(self) -> Iterator[MadeAttribute]:
        for name, attribute in self.rule.attributes.items():
            with ErrorScope(self._report, ("attributes", name)):
                yield attributes.compiled(name, attribute, self._context, self.rule.dead_band)

    def _compiled_alert(self, alert: AlertFromRos) -> Callable[[Any], AlertState]:
        def text(template: Any) -> Callable[[Any], str]:
            return attributes.text(template, self._schema, self._settings)

        key, category, description = text(alert.key), text(alert.category), text(alert.description)
        sub_category = text(alert.sub_category) if alert.sub_category else None
        about = attributes.entity_id(_id_of(alert.about), self._schema, self._settings)
        active = compile_condition(alert.active, self._schema)
        severity: Callable[[Any], Any] | None = None
        if alert.severity is not None:
            severity = attributes.compiled("severity", alert.severity, self._context).make

        def alert_state(scope: Any) -> AlertState:
            is_active = active is not None and active(scope)
            return AlertState(
                key=key(scope),
                about=about(scope),
                active=is_active,
                category=category(scope),
                description=description(scope),
                sub_category=sub_category(scope) if sub_category else None,
                severity=str(severity(scope)) if severity is not None and is_active else "medium",
            )

        return alert_state


class ErrorScope:
    """Reports a `InvalidRule` raised inside it, with its place in the rule, and suppresses it."""

    def __init__(self, report: ReportError, where: tuple[str, ...]) -> None:
        self._report = report
        self._where = where

    def __enter__(self) -> None:
        return None

    def __exit__(self, _: Any, error: BaseException | None, __: Any) -> bool:
        if isinstance(error, InvalidRule):
            self._report(self._where, error)
            return True
        return False


def _id_of(entity: EntityTemplate) -> Any:
    return entity.id


def _replaced(message: dict[str, Any], names: list[str], value: Any) -> dict[str, Any]:
    first, *rest = names
    return {**message, first: _replaced(message[first], rest, value) if rest else value}


def _described(error: Exception) -> str:
    return str(error) if isinstance(error, HandoverError | ValueError) else f"{type(error).__name__}: {error}"


def compile_condition(condition: Condition | None, schema: MessageSchema) -> Holds | None:
    """Return the function that evaluates `condition`; None without one. Raises `InvalidRule`."""
    if condition is None:
        return None
    find, target = schema.find(condition.field), schema.target(condition.field)
    tests = list(_condition_tests(condition))
    if (condition.above is not None or condition.below is not None) and not target.is_number:
        raise InvalidRule(f"{condition.field} is {target}; only a number is `above` or `below` another")

    def holds(scope: Any) -> bool:
        value = find(scope)
        return all(test(value) for test in tests)

    return holds


def _condition_tests(condition: Condition) -> list[Holds]:
    tests: list[Holds] = []
    if "equals" in condition.model_fields_set:
        wanted = condition.equals
        tests.append(lambda value: bool(value == wanted))
    if (any_of := condition.any_of) is not None:
        tests.append(lambda value: value in any_of)
    if (none_of := condition.none_of) is not None:
        tests.append(lambda value: value not in none_of)
    if (above := condition.above) is not None:
        tests.append(lambda value: value > above)
    if (below := condition.below) is not None:
        tests.append(lambda value: value < below)
    return tests
