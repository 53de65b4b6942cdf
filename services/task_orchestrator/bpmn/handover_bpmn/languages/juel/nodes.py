"""Nodes of JUEL: the functions of the variables of which an expression consists."""

from collections.abc import Callable
from typing import Any, TypeAlias

from handover_bpmn.languages.base import ExpressionError, Json, Variables, quote_names
from handover_bpmn.languages.juel.values import coerce_to_boolean, read_property

Node: TypeAlias = Callable[[Variables], Json]


def constant(value: Json) -> Node:
    """Return always the same value."""
    return lambda _: value


def variable_node(name: str, is_lenient: bool) -> Node:
    """Return the value of a variable; one that is missing is an error, or null."""
    if is_lenient:
        return lambda variables: variables.get(name)

    def variable(variables: Variables) -> Json:
        try:
            return variables[name]
        except KeyError:
            names = quote_names(key for key in variables if str(key).isidentifier())
            raise ExpressionError(f'there is no variable "{name}"; variables are: {names}') from None

    return variable


def execution_property(name: str) -> Node:
    """Return a property of the execution."""

    def read(variables: Variables) -> Json:
        execution = variables.get("execution")
        return execution.get(name) if isinstance(execution, dict) else None

    return read


def choose(condition: Node, yes: Node, no: Node) -> Node:
    """Return one of two values."""
    return lambda variables: yes(variables) if coerce_to_boolean(condition(variables)) else no(variables)


def connect(operands: tuple[Node, ...], *, until: bool) -> Node:
    """Return the function that is `until` as soon as an operand is: `or` for True, `and` for False."""

    def connected(variables: Variables) -> Json:
        for operand in operands:
            value = operand(variables)
            if (value if value is True or value is False else coerce_to_boolean(value)) is until:
                return until
        return not until

    return connected


def chain(first: Node, rest: list[tuple[Callable[[Json, Json], Json], Node]]) -> Node:
    """Return the function of operators of one precedence, from left to right."""
    if not rest:
        return first
    if len(rest) == 1:
        calculate, right = rest[0]
        return lambda variables: calculate(first(variables), right(variables))
    steps = tuple(rest)

    def chained(variables: Variables) -> Json:
        value = first(variables)
        for calculate, operand in steps:
            value = calculate(value, operand(variables))
        return value

    return chained


def property_step(name: str) -> Callable[[Json, Variables], Json]:
    """Return the step to a property."""
    return lambda value, _: value.get(name) if type(value) is dict else read_property(value, name)


def index_step(key: Node) -> Callable[[Json, Variables], Json]:
    """Return the step to an entry or item."""
    return lambda value, variables: read_property(value, key(variables))


def follow_path(node: Node, steps: list[Callable[[Any, Variables], Json]]) -> Node:
    """Return the value after all steps of a path."""
    if not steps:
        return node
    if len(steps) == 1:
        step = steps[0]
        return lambda variables: step(node(variables), variables)
    path = tuple(steps)

    def follow(variables: Variables) -> Json:
        value = node(variables)
        for step in path:
            value = step(value, variables)
        return value

    return follow
