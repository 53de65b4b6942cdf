"""Functions of FEEL over texts and single values."""

import json
from base64 import b64encode
from collections.abc import Mapping

from handover_bpmn.languages.base import check_text
from handover_bpmn.languages.feel.function import Function, typed
from handover_bpmn.languages.feel.values import (
    MAX_STRING,
    Budget,
    FeelValue,
    is_number,
    number,
    text,
    to_json,
)
from handover_bpmn.languages.patterns import is_match, replaced, split_at, with_flags


@typed(str, int, int, optional=1)
def _substring(_: Budget, value: str, start: int, *length: int) -> FeelValue:
    if start == 0 or (length and length[0] < 0):
        return None
    first = start - 1 if start > 0 else max(0, len(value) + start)
    return value[first : first + length[0]] if length else value[first:]


@typed(str, str, str, str, optional=1)
def _replace(budget: Budget, value: str, pattern: str, replacement: str, flags: str = "") -> FeelValue:
    made = replaced(value, with_flags(pattern, flags), replacement, MAX_STRING)
    budget.spend(len(value))
    return text(made, budget)


@typed(str, str)
def _split(budget: Budget, value: str, delimiter: str) -> FeelValue:
    parts = split_at(value, delimiter)
    budget.spend(len(value))
    return parts


@typed(str, str)
def _substring_before(_: Budget, value: str, part: str) -> FeelValue:
    return value.partition(part)[0] if part and part in value else ""


@typed(str, str)
def _substring_after(_: Budget, value: str, part: str) -> FeelValue:
    return value.partition(part)[2] if part and part in value else value if not part else ""


@typed(str)
def _to_base64(budget: Budget, value: str) -> FeelValue:
    check_text(value)
    return text(b64encode(value.encode()).decode(), budget)


@typed(list, str, optional=1)
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


@typed(str, str, str, optional=1)
def _matches(budget: Budget, value: str, pattern: str, flags: str = "") -> FeelValue:
    is_matching = is_match(value, with_flags(pattern, flags), is_whole=False)
    budget.spend(len(value))
    return is_matching


def _negate(_: Budget, value: FeelValue) -> FeelValue:
    return not value if isinstance(value, bool) else None


TEXT_FUNCTIONS: Mapping[str, Function] = {
    "not": Function(_negate, 1, 1),
    "contains": typed(str, str)(lambda _, value, part: part in value),
    "starts with": typed(str, str)(lambda _, value, part: value.startswith(part)),
    "ends with": typed(str, str)(lambda _, value, part: value.endswith(part)),
    "matches": _matches,
    "upper case": typed(str)(lambda budget, value: text(value.upper(), budget)),
    "lower case": typed(str)(lambda budget, value: text(value.lower(), budget)),
    "trim": typed(str)(lambda _, value: value.strip()),
    "substring": _substring,
    "substring before": _substring_before,
    "substring after": _substring_after,
    "string length": typed(str)(lambda _, value: len(value)),
    "replace": _replace,
    "split": _split,
    "string join": _string_join,
    "string": Function(_string, 1, 1),
    "number": Function(_number, 1, 3),
    "is blank": typed(str)(lambda _, value: not value.strip()),
    "to base64": _to_base64,
    "is defined": Function(lambda _, value: value is not None, 1, 1),
    "get or else": Function(lambda _, value, default: default if value is None else value, 2, 2),
}
