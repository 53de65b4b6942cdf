"""Outward: a message of the ROS graph becomes updates of entities, attribute by attribute.

What is wrong with one attribute (NaN, an index beyond the end) costs that attribute alone, and is told.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import orjson

from datamodels.times import iso
from handover.errors import HandoverError
from ros_fiware_bridge.mapping import paths
from ros_fiware_bridge.mapping.model import AlertFromRos, EntityTemplate, RosToNgsild
from ros_fiware_bridge.mapping.paths import Path
from ros_fiware_bridge.rules import attributes, conditions
from ros_fiware_bridge.rules.attributes import Ground, MadeAttribute
from ros_fiware_bridge.rules.conditions import Holds
from ros_fiware_bridge.rules.definitions import Anatomy, Definitions, WrongRule
from ros_fiware_bridge.rules.json_values import JsonValues

SURVIVED = (HandoverError, ValueError, TypeError, ArithmeticError, LookupError)
"""What a message may bring about without ending anything."""
Settings = Mapping[str, str]
"""What stands for a place that no message fills, such as `factory`."""
Say = Callable[[tuple[str, ...], WrongRule], None]
"""Told where in a rule something stands that cannot work, and why."""
STAMP = paths.parse("header.stamp")


@dataclass(frozen=True, slots=True)
class Update:
    """What a rule has to say of an entity: `values` to compare, `attributes` as NGSI-LD has them."""

    entity_id: str
    entity_type: str
    values: Mapping[str, Any]
    attributes: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class AlertNews:
    """Whether the Alert of `key` stands; `about` is the entity it is about."""

    key: str
    about: str
    standing: bool
    category: str
    description: str
    sub_category: str | None = None
    severity: str = "medium"


@dataclass(slots=True)
class Harvest:
    """What a message came to."""

    updates: list[Update] = field(default_factory=list)
    alerts: list[AlertNews] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


class Outward:
    """A rule from ROS to NGSI-LD, made ready; `say` is told of each part that cannot work.

    Raises `WrongRule` when nothing of the rule can.
    """

    def __init__(
        self, rule: RosToNgsild, type_name: str, definitions: Definitions, settings: Settings, say: Say
    ) -> None:
        self.rule = rule
        self.type_name = type_name
        self._settings = settings
        self._anatomy = Anatomy(definitions, type_name, rule.each, rule.json_text)
        values = JsonValues(definitions, rule.most_elements, large_arrays=rule.large_arrays)
        self._ground = Ground(self._anatomy, values, settings)
        self._say = say
        self._when: Holds | None = None
        self._attributes: tuple[MadeAttribute, ...] = ()
        self._id: Callable[[Any], str] | None = None
        self._alert: Callable[[Any], AlertNews] | None = None
        self._stamp: Callable[[Any], Any] | None = None
        with Telling(say, ("when",)):
            self._when = conditions.compiled(rule.when, self._anatomy)
        with Telling(say, ("observed_at",)):
            self._stamp = self._observed(rule.observed_at)
        if rule.entity is not None:
            with Telling(say, ("entity",)):
                self._id = attributes.entity_id(rule.entity.id, self._anatomy, self._settings)
        self._attributes = tuple(self._compiled())
        if rule.alert is not None:
            with Telling(say, ("alert",)):
                self._alert = self._compiled_alert(rule.alert)
        self.fields = self._anatomy.fields
        """What it looks at of a message."""
        self.constant_entity = self._is_about_one()
        """Whether every message is about the same entity, so that one need not be read to know which."""

    @property
    def attributes(self) -> tuple[MadeAttribute, ...]:
        """Return the attributes that it makes."""
        return self._attributes

    def harvest(self, message: dict[str, Any], received_at_s: float) -> Harvest:
        """Return what `message` (its `fields` are enough) comes to; whatever it is, nothing is raised."""
        harvest = Harvest()
        try:
            message = self._with_json_read(message)
            observed_at = self._observed_at(message, received_at_s, harvest)
            scopes = list(self._scopes(message))
        except SURVIVED as error:
            harvest.faults.append(_told(error))
            return harvest
        for scope in scopes:
            try:
                if self._when is None or self._when(scope):
                    self._reap(scope, observed_at, harvest)
            except SURVIVED as error:
                harvest.faults.append(_told(error))
        return harvest

    def _is_about_one(self) -> bool:
        entity = self.rule.entity
        return (
            self.rule.each is None
            and self._when is None
            and entity is not None
            and entity.id.with_settings(self._settings).constant is not None
        )

    def _reap(self, scope: Any, observed_at: str | None, harvest: Harvest) -> None:
        if self._alert is not None:
            harvest.alerts.append(self._alert(scope))
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
            except SURVIVED as error:
                harvest.faults.append(f"{attribute.name}: {_told(error)}")
                continue
            values[attribute.name] = value
            written[attribute.name] = attribute.written(value, observed_at)
        if written:
            harvest.updates.append(Update(entity_id, self.rule.entity.type, values, written))

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
        if asked is None and not self._anatomy.has_stamp():
            return None
        self._anatomy.require_time(path)
        return paths.getter(path)

    def _observed_at(self, message: Any, received_at_s: float, harvest: Harvest) -> str | None:
        if self.rule.observed_at == "none":
            return None
        if self._stamp is not None:
            stamp = self._stamp(message)
            seconds = stamp["sec"] + stamp["nanosec"] * 1e-9
            if stamp["sec"] > 0:
                try:
                    return iso(datetime.fromtimestamp(seconds, UTC))
                except (ValueError, OverflowError, OSError):
                    harvest.faults.append(f"the stamp {seconds} is no time; when it was received counts")
        return iso(datetime.fromtimestamp(received_at_s, UTC))

    def _compiled(self) -> Iterator[MadeAttribute]:
        for name, attribute in self.rule.attributes.items():
            with Telling(self._say, ("attributes", name)):
                yield attributes.compiled(name, attribute, self._ground, self.rule.dead_band)

    def _compiled_alert(self, alert: AlertFromRos) -> Callable[[Any], AlertNews]:
        def text(template: Any) -> Callable[[Any], str]:
            return attributes.text(template, self._anatomy, self._settings)

        key, category, description = text(alert.key), text(alert.category), text(alert.description)
        sub_category = text(alert.sub_category) if alert.sub_category else None
        about = attributes.entity_id(_id_of(alert.about), self._anatomy, self._settings)
        standing = conditions.compiled(alert.standing, self._anatomy)
        severity: Callable[[Any], Any] | None = None
        if alert.severity is not None:
            severity = attributes.compiled("severity", alert.severity, self._ground).make

        def news(scope: Any) -> AlertNews:
            stands = standing is not None and standing(scope)
            return AlertNews(
                key=key(scope),
                about=about(scope),
                standing=stands,
                category=category(scope),
                description=description(scope),
                sub_category=sub_category(scope) if sub_category else None,
                severity=str(severity(scope)) if severity is not None and stands else "medium",
            )

        return news


class Telling:
    """Tells `say` of a `WrongRule` and where it stands, and lets the rest go on."""

    def __init__(self, say: Say, where: tuple[str, ...]) -> None:
        self._say = say
        self._where = where

    def __enter__(self) -> None:
        return None

    def __exit__(self, _: Any, error: BaseException | None, __: Any) -> bool:
        if isinstance(error, WrongRule):
            self._say(self._where, error)
            return True
        return False


def _id_of(entity: EntityTemplate) -> Any:
    return entity.id


def _replaced(message: dict[str, Any], names: list[str], value: Any) -> dict[str, Any]:
    first, *rest = names
    return {**message, first: _replaced(message[first], rest, value) if rest else value}


def _told(error: Exception) -> str:
    return str(error) if isinstance(error, HandoverError | ValueError) else f"{type(error).__name__}: {error}"
