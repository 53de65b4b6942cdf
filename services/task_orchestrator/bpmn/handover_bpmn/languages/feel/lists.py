"""Functions of FEEL over lists, contexts and JSON."""

import json
from collections.abc import Callable, Mapping

from handover_bpmn.languages.base import ExpressionError, within_limits
from handover_bpmn.languages.feel.function import AnyValue, Function, over_list, typed
from handover_bpmn.languages.feel.values import Budget, FeelValue, is_same, order, text, to_json


def _count(_: Budget, items: FeelValue) -> FeelValue:
    return len(items) if isinstance(items, list) else None


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


@typed(list, AnyValue)
def _list_contains(budget: Budget, items: list[FeelValue], value: FeelValue) -> FeelValue:
    return any(is_same(item, value, budget) is True for item in items)


@typed(list, AnyValue)
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


@typed(list)
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


@typed(list, int, int, optional=1)
def _sublist(_: Budget, items: list[FeelValue], start: int, *length: int) -> FeelValue:
    if start == 0 or (length and length[0] < 0):
        return None
    first = start - 1 if start > 0 else max(0, len(items) + start)
    return items[first : first + length[0]] if length else items[first:]


@typed(list, int)
def _remove(_: Budget, items: list[FeelValue], position: int) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], *items[index + 1 :]] if position and 0 <= index < len(items) else None


@typed(list, int, AnyValue)
def _insert_before(_: Budget, items: list[FeelValue], position: int, value: FeelValue) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], value, *items[index:]] if position and 0 <= index <= len(items) else None


@typed(dict, (str, list))
def _get_value(budget: Budget, context: dict[str, FeelValue], path: str | list[FeelValue]) -> FeelValue:
    """Return the entry of a key, or of a path of keys; null without one."""
    keys = path if isinstance(path, list) else [path]
    value: FeelValue = context if keys else None
    for key in keys:
        budget.spend(1)
        value = value.get(key) if isinstance(value, dict) and isinstance(key, str) else None
    return value


@typed(dict, (str, list), AnyValue)
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


@typed(list, int)
def _partition(_: Budget, items: list[FeelValue], size: int) -> FeelValue:
    return [items[first : first + size] for first in range(0, len(items), size)] if size > 0 else None


@typed(list, int, AnyValue)
def _list_replace(_: Budget, items: list[FeelValue], position: int, value: FeelValue) -> FeelValue:
    index = position - 1 if position > 0 else len(items) + position
    return [*items[:index], value, *items[index + 1 :]] if position and 0 <= index < len(items) else None


def _to_json(budget: Budget, value: FeelValue) -> FeelValue:
    return text(json.dumps(to_json(value, budget), ensure_ascii=False), budget)


@typed(str)
def _from_json(budget: Budget, value: str) -> FeelValue:
    budget.spend(len(value))
    try:
        return within_limits(json.loads(value, parse_constant=lambda _: None))
    except (ValueError, RecursionError, ExpressionError):
        return None


def _joined(budget: Budget, lists: tuple[FeelValue, ...]) -> FeelValue:
    joined = _concatenate(budget, *lists)
    return None if joined is None else _distinct(budget, joined)


LIST_FUNCTIONS: Mapping[str, Function] = {
    "to json": Function(_to_json, 1, 1),
    "from json": _from_json,
    "count": Function(_count, 1, 1),
    "min": over_list(_extreme(-1)),
    "max": over_list(_extreme(1)),
    "all": over_list(_all),
    "any": over_list(_some),
    "append": Function(_append, 1, 100),
    "concatenate": Function(_concatenate, 1, 100),
    "union": Function(lambda budget, *lists: _joined(budget, lists), 1, 100),
    "distinct values": over_list(_distinct),
    "flatten": _flatten,
    "reverse": typed(list)(lambda _, items: items[::-1]),
    "list contains": _list_contains,
    "index of": _index_of,
    "sublist": _sublist,
    "remove": _remove,
    "insert before": _insert_before,
    "list replace": _list_replace,
    "partition": _partition,
    "duplicate values": typed(list)(_duplicates),
    "is empty": typed(list)(lambda _, items: not items),
    "get value": _get_value,
    "get entries": typed(dict)(
        lambda _, context: [{"key": key, "value": value} for key, value in context.items()]
    ),
    "context put": _context_put,
    "context merge": over_list(_context_merge),
    "context": typed(list)(_context),
}
