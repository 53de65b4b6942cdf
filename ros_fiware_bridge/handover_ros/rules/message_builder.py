"""Builds a message of the ROS graph from attributes, parameters or a response, field by field.

Fields without a source have the default of the message definition.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Protocol

import orjson

from handover.errors import HandoverError
from handover_datamodels.times import parse
from handover_ros.errors import BadMessage
from handover_ros.mapping import paths
from handover_ros.mapping.paths import FieldStep, Index, MissingValue, Path, Where
from handover_ros.mapping.values import Source
from handover_ros.rules import conversion
from handover_ros.rules.entity_extractor import ErrorScope, ReportError
from handover_ros.rules.message_schema import TIME, Definitions, InvalidRule, MessageSchema, PathTarget
from handover_ros.types.definition import FLOATS, TEXTS, FieldType, Many


class Checked(Definitions, Protocol):
    """Definitions that also check messages; see `TypeStore`."""

    def check(self, type_name: str, message: Mapping[str, Any]) -> None:
        """Raise `BadMessage` unless `message` can be sent."""


class Incomplete(HandoverError):
    """A value that a rule requires is missing, so no message is sent."""


@dataclass(frozen=True, slots=True)
class Scope:
    """The values that fields are filled from, by name, and when each was observed (ISO 8601)."""

    values: Mapping[str, Any]
    observed: Mapping[str, str] = field(default_factory=dict)
    now_s: float = 0.0


Fill = Callable[[Scope], Any]
_NOTHING = object()


class MessageBuilder:
    """Builds messages of `type_name`; the source of each field is compiled once."""

    def __init__(
        self,
        type_name: str,
        fields: Mapping[Path, Source],
        definitions: Checked,
        settings: Mapping[str, str],
        report: ReportError,
    ) -> None:
        self.type_name = type_name
        self._definitions = definitions
        self._fills: list[tuple[tuple[_Step, ...], Fill]] = []
        schema = MessageSchema(definitions, type_name)
        for path, source in fields.items():
            with ErrorScope(report, (str(path),)):
                target = schema.target(path)
                steps = tuple(self._steps(path, schema))
                self._fills.append((steps, _filled(path, source, target, settings)))
                self._try_constants(steps, source)

    def message(self, scope: Scope) -> dict[str, Any]:
        """Return the message as a dict.

        Raises `Incomplete`, or another `HandoverError` or ValueError for a value that does not fit.
        """
        made: dict[str, Any] = {}
        for steps, fill in self._fills:
            value = fill(scope)
            if value is _NOTHING:
                continue
            if not steps:
                if not isinstance(value, Mapping):
                    raise MissingValue(f"a whole message is filled from an object, not from {value!r:.60}")
                made = {**made, **value}
            else:
                _put(made, steps, value)
        return made

    def _steps(self, path: Path, schema: MessageSchema) -> "list[_Step]":
        steps: list[_Step] = []
        for place, step in enumerate(path.steps):
            if not isinstance(step, FieldStep | Index):
                raise InvalidRule(f"{path}: a target cannot contain {step}; use a number, as in [0]")
            here = schema.target(Path(path.steps[: place + 1])).type
            assert here is not None  # noqa: S101 - fields of JSON text cannot be set
            following = path.steps[place + 1] if place + 1 < len(path.steps) else None
            key: str | int = step.name if isinstance(step, FieldStep) else step.place
            filler = _empty(here.item) if isinstance(following, Index) else None
            size = here.size if isinstance(following, Index) and here.many is Many.FIXED else 0
            steps.append(_Step(key, filler, size))
        return steps

    def _try_constants(self, steps: "tuple[_Step, ...]", source: Source) -> None:
        """Refuse a constant, default or mapped value that can never be sent."""
        constants = [source.constant] if "constant" in source.model_fields_set else []
        constants += [source.default] if "default" in source.model_fields_set else []
        constants += [value for value in (source.values or {}).values() if value is not None]
        constants += [source.otherwise] if source.otherwise is not None else []
        for value in constants:
            made: dict[str, Any] = {}
            if steps:
                _put(made, steps, value)
            else:
                made = value
            try:
                self._definitions.check(self.type_name, made)
            except BadMessage as error:
                raise InvalidRule(str(error)) from None


@dataclass(frozen=True, slots=True)
class _Step:
    """One step to the field that is set; `filler` creates elements of its array, `size` of them if fixed."""

    key: str | int
    filler: Callable[[], Any] | None
    size: int = 0


def _put(made: dict[str, Any], steps: tuple[_Step, ...], value: Any) -> None:
    here: Any = made
    for place, step in enumerate(steps):
        if isinstance(step.key, int):
            before = steps[place - 1].filler
            while len(here) <= step.key and before is not None:
                here.append(before())
        if place + 1 == len(steps):
            here[step.key] = value
            return
        empty: Any = {}
        if (filler := step.filler) is not None:
            empty = [filler() for _ in range(step.size)]
        here = here[step.key] if isinstance(step.key, int) else here.setdefault(step.key, empty)


def _empty(kind: FieldType) -> Callable[[], Any]:
    if kind.is_message:
        return dict
    if kind.base in TEXTS:
        return str
    if kind.base == "bool":
        return bool
    return float if kind.base in FLOATS else int


def _filled(path: Path, source: Source, target: PathTarget, settings: Mapping[str, str]) -> Fill:
    reader = _found(path, source, target, settings)
    convert = conversion.compiled(source)
    default = source.default if "default" in source.model_fields_set else _NOTHING
    if source.units == conversion.YAW_TO_QUATERNION:
        if not target.is_message(conversion.QUATERNION):
            raise InvalidRule(f"{path} is {target}; a yaw becomes a {conversion.QUATERNION}")
    elif source.convert is not None and not target.is_number and not target.is_text:
        raise InvalidRule(f"{path} is {target}, and only numbers are converted")

    def fill(scope: Scope) -> Any:
        try:
            value = reader(scope)
        except MissingValue:
            value = None
        if value is None:
            if source.required:
                raise Incomplete(f"{path} is not filled: there is no {_place_of(source)}")
            return default
        return value if convert is None else convert(value)

    return fill


def _found(path: Path, source: Source, target: PathTarget, settings: Mapping[str, str]) -> Fill:
    if source.attribute is not None:
        return _by_path(source.attribute)
    if (name := source.name) is not None:
        return lambda scope: scope.values.get(name)
    if source.observed_at is not None or source.now:
        return _moment(path, source, target)
    if source.text is not None or source.json_of is not None or source.json_fields is not None:
        return _words(path, source, target, settings)
    constant = source.constant
    return lambda _: constant


def _moment(path: Path, source: Source, target: PathTarget) -> Fill:
    if not target.is_message(TIME):
        raise InvalidRule(f"{path} is {target}, not a time ({TIME})")
    if (observed := source.observed_at) is not None:
        return lambda scope: _time_of(scope.observed.get(observed))
    return lambda scope: _time(scope.now_s)


def _words(path: Path, source: Source, target: PathTarget, settings: Mapping[str, str]) -> Fill:
    if not target.is_text:
        raise InvalidRule(f"{path} is {target}, and text goes into a string")
    if source.text is not None:
        return source.text.with_settings(settings).filler(_by_path)
    if source.json_fields is not None:
        finds = {name: _by_path(path) for name, path in source.json_fields.items()}
        return lambda scope: _json({name: _or_none(find, scope) for name, find in finds.items()})
    of = str(source.json_of)
    return lambda scope: _json(scope.values if of == "." else scope.values.get(of))


def _by_path(path: Path) -> Fill:
    if any(not isinstance(step, FieldStep | Index | Where) for step in path.steps):
        raise InvalidRule(f"{path}: here nothing is gone through element by element; drop the []")
    find = paths.getter(path)
    return lambda scope: find(scope.values)


def _or_none(find: Fill, scope: Scope) -> Any:
    try:
        return find(scope)
    except MissingValue:
        return None


def _json(value: Any) -> str | None:
    return None if value is None else orjson.dumps(value, option=orjson.OPT_NON_STR_KEYS).decode()


def _time_of(text: str | None) -> dict[str, int] | None:
    return None if text is None else _time(parse(text).timestamp())


def _time(seconds: float) -> dict[str, int]:
    moment = datetime.fromtimestamp(seconds, UTC)
    return {"sec": int(seconds // 1), "nanosec": moment.microsecond * 1000}


def _place_of(source: Source) -> str:
    return str(source.attribute or source.name or source.observed_at or source.json_of or source.text)
