"""Functions of FEEL over numbers."""

import math
import statistics
from collections.abc import Callable, Mapping

from handover.formats.durations import Duration
from handover_bpmn.languages.feel.function import NUMBER, Function, over_list, typed
from handover_bpmn.languages.feel.values import Budget, FeelValue, add, is_number, number


def _sum(budget: Budget, items: list[FeelValue]) -> FeelValue:
    if not items:
        return None
    total: FeelValue = items[0]
    for item in items[1:]:
        total = add(total, item, budget) if not isinstance(item, str) else None
    return total if is_number(total) or isinstance(total, Duration) else None


def _mean(budget: Budget, items: list[FeelValue]) -> FeelValue:
    return number(total / len(items)) if is_number(total := _sum(budget, items)) else None


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

    return over_list(calculated)


def _mode(_: Budget, items: list[FeelValue]) -> FeelValue:
    if not all(is_number(item) for item in items):
        return None
    return sorted(statistics.multimode(items))


def _rounded(choose: Callable[[float], float]) -> Function:
    """Return a function that rounds a number to an integer, or to a number of decimals."""

    @typed(NUMBER, int, optional=1)
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


@typed(NUMBER, int)
def _round_half_even(_: Budget, value: float, digits: int) -> FeelValue:
    return number(round(value, digits)) if -15 <= digits <= 15 else None


@typed(NUMBER, NUMBER)
def _modulo(_: Budget, dividend: float, divisor: float) -> FeelValue:
    return number(dividend % divisor) if divisor else None


def _absolute(_: Budget, value: FeelValue) -> FeelValue:
    if isinstance(value, Duration):
        return Duration(abs(value.months), abs(value.microseconds))
    return abs(value) if is_number(value) else None


NUMBER_FUNCTIONS: Mapping[str, Function] = {
    "sum": over_list(_sum),
    "mean": over_list(_mean),
    "median": _numbers(statistics.median),
    "stddev": _numbers(statistics.stdev),
    "mode": over_list(_mode),
    "product": _numbers(math.prod),
    "floor": _rounded(math.floor),
    "ceiling": _rounded(math.ceil),
    "round up": _rounded(lambda value: math.copysign(math.ceil(abs(value)), value)),
    "round down": _rounded(math.trunc),
    "round half up": _rounded(_half_up),
    "decimal": _round_half_even,
    "round": _rounded(_half_up),
    "abs": Function(_absolute, 1, 1),
    "modulo": _modulo,
    "sqrt": typed(NUMBER)(lambda _, value: number(math.sqrt(value)) if value >= 0 else None),
    "log": typed(NUMBER)(lambda _, value: number(math.log(value)) if value > 0 else None),
    "exp": typed(NUMBER)(lambda _, value: number(math.exp(value)) if value < 700 else None),
    "odd": typed(NUMBER)(lambda _, value: value % 2 == 1),
    "even": typed(NUMBER)(lambda _, value: value % 2 == 0),
}
