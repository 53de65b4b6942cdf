"""Functions of FEEL; an argument of the wrong type makes the result null."""

import calendar
import json
import math
import statistics
from base64 import b64encode
from collections.abc import Callable, Mapping
from datetime import date
from typing import Any, NamedTuple

from handover.formats.durations import Duration
from handover_bpmn.languages.base import ExpressionError, check_text, within_limits
from handover_bpmn.languages.feel_values import (
    MAX_STRING,
    Budget,
    FeelValue,
    add,
    is_number,
    is_same,
    number,
    order,
    text,
    to_date,
    to_datetime,
    to_duration,
    to_json,
)
from handover_bpmn.languages.patterns import is_match, replaced, split_at, with_flags


class Function(NamedTuple):
    """A function of the budget and its arguments, with the numbers of arguments that it can take."""

    call: Callable[..., FeelValue]
    least: int
    most: int


class _Any:
    """Matches every value."""


_NUMBER = (int, float)


def _typed(*kinds: Any, optional: int = 0) -> Callable[[Callable[..., FeelValue]], Function]:
    """Return a decorator for a function whose arguments have these types, else its result is null."""

    def decorate(call: Callable[..., FeelValue]) -> Function:
        def checked(budget: Budget, *arguments: FeelValue) -> FeelValue:
            for argument, kind in zip(arguments, kinds, strict=False):
                if kind is _Any:
                    continue
                if not isinstance(argument, kind) or (isinstance(argument, bool) and kind is not bool):
                    return None
                if isinstance(argument, str):
                    budget.spend(len(argument) >> 6)
                elif isinstance(argument, list | dict):
                    budget.spend(len(argument))
            return call(budget, *arguments)

        return Function(checked, len(kinds) - optional, len(kinds))

    return decorate


def _over_list(call: Callable[[Budget, list[FeelValue]], FeelValue]) -> Function:
    """Return a function of one list, or of its items as arguments."""

    def listed(budget: Budget, *arguments: FeelValue) -> FeelValue:
        first = arguments[0]
        if len(arguments) == 1 and first is None:
            return None
        items = first if len(arguments) == 1 and isinstance(first, list) else list(arguments)
        budget.spend(len(items))
        return call(budget, items)

    return Function(listed, 1, 100)


# Texts


@_typed(str, int, int, optional=1)
def _substring(_: Budget, value: str, start: int, *length: int) -> FeelValue:
    if start == 0 or (length and length[0] < 0):
        return None
    first = start - 1 if start > 0 else max(0, len(value) + start)
    return value[first : first + length[0]] if length else value[first:]


@_typed(str, str, str, str, optional=1)
def _replace(budget: Budget, value: str, pattern: str, replacement: str, flags: str = "") -> FeelValue:
    made = replaced(value, with_flags(pattern, flags), replacement, MAX_STRING)
    budget.spend(len(value))
    return text(made, budget)


@_typed(str, str)
def _split(budget: Budget, value: str, delimiter: str) -> FeelValue:
    parts = split_at(value, delimiter)
    budget.spend(len(value))
    return parts


@_typed(str, str)
def _substring_before(_: Budget, value: str, part: str) -> FeelValue:
    return value.partition(part)[0] if part and part in value else ""


@_typed(str, str)
def _substring_after(_: Budget, value: str, part: str) -> FeelValue:
    return value.partition(part)[2] if part and part in value else value if not part else ""


@_typed(str)
def _to_base64(budget: Budget, value: str) -> FeelValue:
    check_text(value)
    return text(b64encode(value.encode()).decode(), budget)


@_typed(list, str, optional=1)
def _string_join(budget: Budget, items: list[FeelValue], separator: str = "") -> FeelValue:
    texts = [item for item in items if item is not None]
    if not all(isinstance(item, str) for item in texts):
        return None
    if sum(map(len, texts)) + len(separator) * len(texts) > MAX_STRING:
        return text("x" * (MAX_STRING + 1), budget)
    return text(separator.join(texts), budget)


def _string(budget: Budget, value: FeelValue) -> FeelValue:
    if value is None or isinstance(value, str):
        return value
    plain = to_json(value, budget)
    return text(plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False), budget)


def _number(_: Budget, value: FeelValue, *separators: FeelValue) -> FeelValue:
    """Return the number that a text spells; `separators` are those of groups and of decimals."""
    if is_number(value) and not separators:
        return value
    if not isinstance(value, str) or len(value) > 64:
        return None
    digits = value.strip()
    for separator, meant in zip(separators, ("", "."), strict=False):
        if isinstance(separator, str) and len(separator) == 1:
            digits = digits.replace(separator, meant)
        elif separator is not None:
            return None
    if not digits.isascii() or "_" in digits or digits.strip("+-.eE0123456789"):
        return None
    try:
        parsed = float(digits)
        return number(int(digits) if digits.lstrip("+-").isdigit() else parsed)
    except (ValueError, OverflowError):
        return None


@_typed(str, str, str, optional=1)
def _matches(budget: Budget, value: str, pattern: str, flags: str = "") -> FeelValue:
    is_matching = is_match(value, with_flags(pattern, flags), is_whole=False)
    budget.spend(len(value))
    return is_matching


# Lists and contexts


def _count(_: Budget, items: FeelValue) -> FeelValue:
    return len(items) if isinstance(items, list) else None


def _sum(budget: Budget, items: list[FeelValue]) -> FeelValue:
    if not items:
        return None
    total: FeelValue = items[0]
    for item in items[1:]:
        total = add(total, item, budget) if not isinstance(item, str) else None
    return total if is_number(total) or isinstance(total, Duration) else None


def _mean(budget: Budget, items: list[FeelValue]) -> FeelValue:
    return number(total / len(items)) if is_number(total := _sum(budget, items)) else None


def _extreme(sign: int) -> Callable[[Budget, list[FeelValue]], FeelValue]:
    def extreme(budget: Budget, items: list[FeelValue]) -> FeelValue:
        if not items:
            return None
        best = items[0]
        for item in items:
            ordering = order(item, best, budget)
            if ordering is None:
                return None
            best = item if ordering == sign else best
        return best

    return extreme


def _all(_: Budget, items: list[FeelValue]) -> FeelValue:
    if any(item is False for item in items):
        return False
    return True if all(item is True for item in items) else None


def _some(_: Budget, items: list[FeelValue]) -> FeelValue:
    if any(item is True for item in items):
        return True
    return False if all(item is False for item in items) else None


@_typed(list, _Any)
def _list_contains(budget: Budget, items: list[FeelValue], value: FeelValue) -> FeelValue:
    return any(is_same(item, value, budget) is True for item in items)


@_typed(list, _Any)
def _index_of(budget: Budget, items: list[FeelValue], value: FeelValue) -> FeelValue:
    return [index for index, item in enumerate(items, 1) if is_same(item, value, budget) is True]


def _append(budget: Budget, items: FeelValue, *values: FeelValue) -> FeelValue:
    items = items if isinstance(items, list) else [items]
    budget.spend(len(items))
    return [*items, *values]


def _concatenate(budget: Budget, *lists: FeelValue) -> FeelValue:
    joined: list[FeelValue] = []
    for items in lists:
        if items is None:
            return None
        joined += items if isinstance(items, list) else [items]
        budget.spend(len(joined))
    return joined


def _distinct(budget: Budget, items: list[FeelValue]) -> FeelValue:
    distinct: list[FeelValue] = []
    for item in items:
        budget.spend(len(distinct))
        if not any(is_same(item, other, budget) is True for other in distinct):
            distinct.append(item)
    return distinct


@_typed(list)
def _flatten(budget: Budget, items: list[FeelValue]) -> FeelValue:
    flat: list[FeelValue] = []
    stack = [iter(items)]
    while stack:
        for item in stack[-1]:
            budget.spend(1)
            if isinstance(item, list):
                stack.append(iter(item))
                break
            flat.append(item)
        else:
            stack.pop()
    return flat


@_typed(list, int, int, optional=1)
def _sublist(_: Budget, items: list[FeelValue], start: int, *length: int) -> FeelValue:
    if start == 0 or (length and length[0] < 0):
        return None
    first = start - 1 if start > 0 else max(0, len(items) + start)
    return items[first : first + length[0]] if length else items[first:]


@_typed(list, int)
def _remove(_: Budget, items: list[FeelValue], position: int) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], *items[index + 1 :]] if position and 0 <= index < len(items) else None


@_typed(list, int, _Any)
def _insert_before(_: Budget, items: list[FeelValue], position: int, value: FeelValue) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], value, *items[index:]] if position and 0 <= index <= len(items) else None


@_typed(dict, (str, list))
def _get_value(budget: Budget, context: dict[str, FeelValue], path: str | list[FeelValue]) -> FeelValue:
    """Return the entry of a key, or of a path of keys; null without one."""
    keys = path if isinstance(path, list) else [path]
    value: FeelValue = context if keys else None
    for key in keys:
        budget.spend(1)
        value = value.get(key) if isinstance(value, dict) and isinstance(key, str) else None
    return value


@_typed(dict, (str, list), _Any)
def _context_put(
    budget: Budget, context: dict[str, FeelValue], path: str | list[FeelValue], value: FeelValue
) -> FeelValue:
    """Return the context with the entry of a key, or of a path of keys, whose contexts are added."""
    keys = path if isinstance(path, list) else [path]
    if not keys or not all(isinstance(key, str) for key in keys):
        return None
    made = inner = {**context}
    for key in keys[:-1]:
        below = inner.get(key)
        below = {**below} if isinstance(below, dict) else {}
        budget.spend(1 + len(below))
        inner[key] = below
        inner = below
    inner[keys[-1]] = value
    return made


def _context_merge(budget: Budget, contexts: list[FeelValue]) -> FeelValue:
    merged: dict[str, FeelValue] = {}
    for context in contexts:
        if not isinstance(context, dict):
            return None
        budget.spend(len(context))
        merged.update(context)
    return merged


def _context(budget: Budget, entries: list[FeelValue]) -> FeelValue:
    made: dict[str, FeelValue] = {}
    for entry in entries:
        budget.spend(1)
        if (
            not isinstance(entry, dict)
            or not isinstance(key := entry.get("key"), str)
            or "value" not in entry
        ):
            return None
        made[key] = entry["value"]
    return made


def _duplicates(budget: Budget, items: list[FeelValue]) -> FeelValue:
    matches: list[FeelValue] = []
    for index, item in enumerate(items):
        budget.spend(len(items))
        if any(is_same(item, other, budget) is True for other in items[index + 1 :]) and not any(
            is_same(item, other, budget) is True for other in matches
        ):
            matches.append(item)
    return matches


@_typed(list, int)
def _partition(_: Budget, items: list[FeelValue], size: int) -> FeelValue:
    return [items[first : first + size] for first in range(0, len(items), size)] if size > 0 else None


@_typed(list, int, _Any)
def _list_replace(_: Budget, items: list[FeelValue], position: int, value: FeelValue) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], value, *items[index + 1 :]] if position and 0 <= index < len(items) else None


def _to_json(budget: Budget, value: FeelValue) -> FeelValue:
    return text(json.dumps(to_json(value, budget), ensure_ascii=False), budget)


@_typed(str)
def _from_json(budget: Budget, value: str) -> FeelValue:
    budget.spend(len(value))
    try:
        return within_limits(json.loads(value, parse_constant=lambda _: None))
    except (ValueError, RecursionError, ExpressionError):
        return None


# Numbers


def _numbers(calculate: Callable[[list[float]], float]) -> Function:
    """Return a function of numbers; of anything else its value is null."""

    def calculated(_: Budget, items: list[FeelValue]) -> FeelValue:
        values = [float(item) for item in items if is_number(item)]
        if len(values) < len(items) or not values:
            return None
        try:
            result = calculate(values)
            return number(int(result) if result.is_integer() else result) if math.isfinite(result) else None
        except (statistics.StatisticsError, OverflowError):
            return None

    return _over_list(calculated)


def _mode(_: Budget, items: list[FeelValue]) -> FeelValue:
    if not all(is_number(item) for item in items):
        return None
    return sorted(statistics.multimode(items))


def _rounded(choose: Callable[[float], float]) -> Function:
    """Return a function that rounds a number to an integer, or to a number of decimals."""

    @_typed(_NUMBER, int, optional=1)
    def rounded(_: Budget, value: float, digits: int = 0) -> FeelValue:
        if not -15 <= digits <= 15:
            return None
        scale: float = 10**digits
        return (
            number(value) if isinstance(value, int) and digits >= 0 else number(choose(value * scale) / scale)
        )

    return rounded


def _half_up(value: float) -> float:
    return math.copysign(math.floor(abs(value) + 0.5), value)


@_typed(_NUMBER, int)
def _round_half_even(_: Budget, value: float, digits: int) -> FeelValue:
    return number(round(value, digits)) if -15 <= digits <= 15 else None


@_typed(_NUMBER, _NUMBER)
def _modulo(_: Budget, dividend: float, divisor: float) -> FeelValue:
    return number(dividend % divisor) if divisor else None


def _absolute(_: Budget, value: FeelValue) -> FeelValue:
    if isinstance(value, Duration):
        return Duration(abs(value.months), abs(value.microseconds))
    return abs(value) if is_number(value) else None


# Dates

_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
_MONTHS = (
    *("January", "February", "March", "April", "May", "June", "July"),
    *("August", "September", "October", "November", "December"),
)


def _date(_: Budget, *parts: FeelValue) -> FeelValue:
    if len(parts) == 1:
        return to_date(parts[0])
    if len(parts) != 3 or not all(isinstance(part, int) and not isinstance(part, bool) for part in parts):
        return None
    try:
        return date(*parts)
    except (ValueError, OverflowError):
        return None


@_typed(date)
def _day_of_week(_: Budget, value: date) -> FeelValue:
    return _DAYS[value.weekday()]


@_typed(date)
def _month_of_year(_: Budget, value: date) -> FeelValue:
    return _MONTHS[value.month - 1]


@_typed(date)
def _last_day_of_month(_: Budget, value: date) -> FeelValue:
    return date(value.year, value.month, calendar.monthrange(value.year, value.month)[1])


@_typed(date, date)
def _months_between(budget: Budget, start: date, end: date) -> FeelValue:
    if order(start, end, budget) is None:
        raise ExpressionError(
            "years and months duration() needs two dates, or two dates and times that both have an offset "
            "or both have none"
        )
    first, last = min(start, end), max(start, end)
    months = (last.year - first.year) * 12 + last.month - first.month - (last.day < first.day)
    return Duration(months if start <= end else -months, 0)


def _cycle(budget: Budget, *parts: FeelValue) -> FeelValue:
    """Return the text of a timer that repeats, as the function of Zeebe does."""
    *counts, interval = parts
    if not isinstance(interval, Duration):
        return None
    every = to_json(interval, budget)
    if not counts or counts[0] is None:
        return f"R/{every}"
    count = counts[0]
    return f"R{count}/{every}" if isinstance(count, int) and not isinstance(count, bool) else None


def _negate(_: Budget, value: FeelValue) -> FeelValue:
    return not value if isinstance(value, bool) else None


FUNCTIONS: Mapping[str, Function] = {
    "not": Function(_negate, 1, 1),
    "contains": _typed(str, str)(lambda _, value, part: part in value),
    "starts with": _typed(str, str)(lambda _, value, part: value.startswith(part)),
    "ends with": _typed(str, str)(lambda _, value, part: value.endswith(part)),
    "matches": _matches,
    "upper case": _typed(str)(lambda budget, value: text(value.upper(), budget)),
    "lower case": _typed(str)(lambda budget, value: text(value.lower(), budget)),
    "trim": _typed(str)(lambda _, value: value.strip()),
    "substring": _substring,
    "substring before": _substring_before,
    "substring after": _substring_after,
    "string length": _typed(str)(lambda _, value: len(value)),
    "replace": _replace,
    "split": _split,
    "string join": _string_join,
    "string": Function(_string, 1, 1),
    "number": Function(_number, 1, 3),
    "is blank": _typed(str)(lambda _, value: not value.strip()),
    "to base64": _to_base64,
    "to json": Function(_to_json, 1, 1),
    "from json": _from_json,
    "count": Function(_count, 1, 1),
    "sum": _over_list(_sum),
    "min": _over_list(_extreme(-1)),
    "max": _over_list(_extreme(1)),
    "mean": _over_list(_mean),
    "median": _numbers(statistics.median),
    "stddev": _numbers(statistics.stdev),
    "mode": _over_list(_mode),
    "product": _numbers(math.prod),
    "all": _over_list(_all),
    "any": _over_list(_some),
    "append": Function(_append, 1, 100),
    "concatenate": Function(_concatenate, 1, 100),
    "union": Function(lambda budget, *lists: _joined(budget, lists), 1, 100),
    "distinct values": _over_list(_distinct),
    "flatten": _flatten,
    "reverse": _typed(list)(lambda _, items: items[::-1]),
    "list contains": _list_contains,
    "index of": _index_of,
    "sublist": _sublist,
    "remove": _remove,
    "insert before": _insert_before,
    "list replace": _list_replace,
    "partition": _partition,
    "duplicate values": _typed(list)(_duplicates),
    "is empty": _typed(list)(lambda _, items: not items),
    "get value": _get_value,
    "get entries": _typed(dict)(
        lambda _, context: [{"key": key, "value": value} for key, value in context.items()]
    ),
    "context put": _context_put,
    "context merge": _over_list(_context_merge),
    "context": _typed(list)(_context),
    "is defined": Function(lambda _, value: value is not None, 1, 1),
    "get or else": Function(lambda _, value, default: default if value is None else value, 2, 2),
    "floor": _rounded(math.floor),
    "ceiling": _rounded(math.ceil),
    "round up": _rounded(lambda value: math.copysign(math.ceil(abs(value)), value)),
    "round down": _rounded(math.trunc),
    "round half up": _rounded(_half_up),
    "decimal": _round_half_even,
    "round": _rounded(_half_up),
    "abs": Function(_absolute, 1, 1),
    "modulo": _modulo,
    "sqrt": _typed(_NUMBER)(lambda _, value: number(math.sqrt(value)) if value >= 0 else None),
    "log": _typed(_NUMBER)(lambda _, value: number(math.log(value)) if value > 0 else None),
    "exp": _typed(_NUMBER)(lambda _, value: number(math.exp(value)) if value < 700 else None),
    "odd": _typed(_NUMBER)(lambda _, value: value % 2 == 1),
    "even": _typed(_NUMBER)(lambda _, value: value % 2 == 0),
    "date": Function(_date, 1, 3),
    "date and time": Function(lambda _, value: to_datetime(value), 1, 1),
    "duration": Function(lambda _, value: to_duration(value), 1, 1),
    "day of week": _day_of_week,
    "month of year": _month_of_year,
    "day of year": _typed(date)(lambda _, value: value.timetuple().tm_yday),
    "week of year": _typed(date)(lambda _, value: value.isocalendar().week),
    "last day of month": _last_day_of_month,
    "years and months duration": _months_between,
    "cycle": Function(_cycle, 1, 2),
}
"""The functions by name; `now` and `today` depend on the variables and are part of the parser."""


def _joined(budget: Budget, lists: tuple[FeelValue, ...]) -> FeelValue:
    joined = _concatenate(budget, *lists)
    return None if joined is None else _distinct(budget, joined)
