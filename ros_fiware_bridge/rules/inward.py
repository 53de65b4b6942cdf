"""Inward: attributes, parameters or an answer become a message of the ROS graph, field by field.

What no rule fills takes its default from the message definition.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Protocol

import orjson

from datamodels.times import parse
from handover.errors import HandoverError
from ros_fiware_bridge.errors import BadMessage
from ros_fiware_bridge.mapping import paths
from ros_fiware_bridge.mapping.paths import Field, Index, NotThere, Path, Where
from ros_fiware_bridge.mapping.values import Source
from ros_fiware_bridge.rules import conversion
from ros_fiware_bridge.rules.definitions import TIME, Anatomy, Definitions, Leads, WrongRule
from ros_fiware_bridge.rules.outward import Say, Telling
from ros_fiware_bridge.types.definition import FLOATS, FieldType, Many


class Checked(Definitions, Protocol):
    """Definitions that also know whether a message fits."""

    def check(self, type_name: str, message: Mapping[str, Any]) -> None:
        """Raise `BadMessage` unless `message` could be sent."""


class Incomplete(HandoverError):
    """Something that a rule requires is not there (yet), so nothing is said."""


@dataclass(frozen=True, slots=True)
class Scope:
    """What fields are filled from: values by name, and when each was observed (ISO 8601)."""

    values: Mapping[str, Any]
    observed: Mapping[str, str] = field(default_factory=dict)
    now_s: float = 0.0


Fill = Callable[[Scope], Any]
_NOTHING = object()


class Inward:
    """The fields of a message of `type_name`, and what each is filled from, made ready."""

    def __init__(
        self,
        type_name: str,
        fields: Mapping[Path, Source],
        definitions: Checked,
        settings: Mapping[str, str],
        say: Say,
    ) -> None:
        self.type_name = type_name
        self._definitions = definitions
        self._fills: list[tuple[tuple[_Step, ...], Fill]] = []
        anatomy = Anatomy(definitions, type_name)
        for path, source in fields.items():
            with Telling(say, (str(path),)):
                leads = anatomy.leads(path)
                steps = tuple(self._steps(path, anatomy))
                self._fills.append((steps, _filled(path, source, leads, settings)))
                self._try_constants(steps, source)

    def message(self, scope: Scope) -> dict[str, Any]:
        """Return the message.

        Raises `Incomplete`, or another `HandoverError` or ValueError when a value cannot be taken.
        """
        made: dict[str, Any] = {}
        for steps, fill in self._fills:
            value = fill(scope)
            if value is _NOTHING:
                continue
            if not steps:
                if not isinstance(value, Mapping):
                    raise NotThere(f"a whole message is filled from an object, not from {value!r:.60}")
                made = {**made, **value}
            else:
                _put(made, steps, value)
        return made

    def _steps(self, path: Path, anatomy: Anatomy) -> "list[_Step]":
        steps: list[_Step] = []
        for place, step in enumerate(path.steps):
            if not isinstance(step, Field | Index):
                raise WrongRule(f"{path}: what is filled is named without {step}; use a number, as in [0]")
            here = anatomy.leads(Path(path.steps[: place + 1])).type
            assert here is not None  # noqa: S101 - no JSON text is written into
            following = path.steps[place + 1] if place + 1 < len(path.steps) else None
            key: str | int = step.name if isinstance(step, Field) else step.place
            filler = _empty(here.item) if isinstance(following, Index) else None
            size = here.size if isinstance(following, Index) and here.many is Many.FIXED else 0
            steps.append(_Step(key, filler, size))
        return steps

    def _try_constants(self, steps: "tuple[_Step, ...]", source: Source) -> None:
        """Refuse what could never be sent: a constant, a default or a mapped value that does not fit."""
        given = [source.constant] if "constant" in source.model_fields_set else []
        given += [source.default] if "default" in source.model_fields_set else []
        given += [value for value in (source.values or {}).values() if value is not None]
        given += [source.otherwise] if source.otherwise is not None else []
        for value in given:
            made: dict[str, Any] = {}
            if steps:
                _put(made, steps, value)
            else:
                made = value
            try:
                self._definitions.check(self.type_name, made)
            except BadMessage as error:
                raise WrongRule(str(error)) from None


@dataclass(frozen=True, slots=True)
class _Step:
    """One step to where a value is put; `filler` makes elements of the array there, of `size` if fixed."""

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


def _empty(one: FieldType) -> Callable[[], Any]:
    if one.is_message:
        return dict
    if one.base == "string":
        return str
    if one.base == "bool":
        return bool
    return float if one.base in FLOATS else int


def _filled(path: Path, source: Source, leads: Leads, settings: Mapping[str, str]) -> Fill:
    found = _found(path, source, leads, settings)
    convert = conversion.compiled(source)
    default = source.default if "default" in source.model_fields_set else _NOTHING
    if source.convert is not None and not leads.is_number and leads.type != FieldType("string"):
        raise WrongRule(f"{path} is {leads}, and only numbers are converted")

    def fill(scope: Scope) -> Any:
        try:
            value = found(scope)
        except NotThere:
            value = None
        if value is None:
            if source.required:
                raise Incomplete(f"{path} is not filled: there is no {_place_of(source)}")
            return default
        return value if convert is None else convert(value)

    return fill


def _found(path: Path, source: Source, leads: Leads, settings: Mapping[str, str]) -> Fill:
    if source.attribute is not None:
        return _by_path(source.attribute)
    if (name := source.name) is not None:
        return lambda scope: scope.values.get(name)
    if source.observed_at is not None or source.now:
        return _moment(path, source, leads)
    if source.text is not None or source.json_of is not None or source.json_fields is not None:
        return _words(path, source, leads, settings)
    constant = source.constant
    return lambda _: constant


def _moment(path: Path, source: Source, leads: Leads) -> Fill:
    if not leads.is_message(TIME):
        raise WrongRule(f"{path} is {leads}, not a time ({TIME})")
    if (observed := source.observed_at) is not None:
        return lambda scope: _time_of(scope.observed.get(observed))
    return lambda scope: _time(scope.now_s)


def _words(path: Path, source: Source, leads: Leads, settings: Mapping[str, str]) -> Fill:
    if not leads.is_text:
        raise WrongRule(f"{path} is {leads}, and text goes into a string")
    if source.text is not None:
        return source.text.with_settings(settings).filler(_by_path)
    if source.json_fields is not None:
        finds = {name: _by_path(path) for name, path in source.json_fields.items()}
        return lambda scope: _json({name: _or_none(find, scope) for name, find in finds.items()})
    of = str(source.json_of)
    return lambda scope: _json(scope.values if of == "." else scope.values.get(of))


def _by_path(path: Path) -> Fill:
    if any(not isinstance(step, Field | Index | Where) for step in path.steps):
        raise WrongRule(f"{path}: here nothing is gone through element by element; drop the []")
    find = paths.getter(path)
    return lambda scope: find(scope.values)


def _or_none(find: Fill, scope: Scope) -> Any:
    try:
        return find(scope)
    except NotThere:
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
