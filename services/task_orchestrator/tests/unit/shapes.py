"""Shapes: drawings of any structure for tests, put together of blocks with one way in and one way out."""

from collections.abc import Iterator
from itertools import count
from typing import Any

from hypothesis import strategies as st

from services.task_orchestrator.tests.unit.drawing import activity, end, flow, gateway, start


class Block:
    """A piece of a drawing with one way in and one way out."""

    def __init__(self, body: str, first: str, last: str, last_activity: str | None = None) -> None:
        self.body, self.first, self.last = body, first, last
        self.last_activity = last_activity
        """The activity that is always completed last here."""


def build(shape: Any, numbers: Iterator[int]) -> Block:
    kind, *parts = shape
    name = f"{kind}{next(numbers)}"
    if kind == "do":
        return Block(activity(name), name, name, name)
    if kind == "script":
        text = f'<bpmn:scriptTask id="{name}"><bpmn:script>go = not go</bpmn:script></bpmn:scriptTask>'
        return Block(text, name, name)
    first, *others = [build(part, numbers) for part in parts]
    if kind == "then":
        (second,) = others
        return Block(
            first.body + second.body + flow(first.last, second.first),
            first.first,
            second.last,
            second.last_activity,
        )
    if kind == "loop":
        condition = f"{first.last_activity}.ok" if first.last_activity else "go"
        body = first.body + gateway(f"{name}_in") + gateway(f"{name}_out", default=f"{name}_out_{name}_done")
        body += gateway(f"{name}_done") + flow(f"{name}_in", first.first) + flow(first.last, f"{name}_out")
        body += flow(f"{name}_out", f"{name}_in", condition) + flow(f"{name}_out", f"{name}_done")
        return Block(body, f"{name}_in", f"{name}_done", first.last_activity)
    gateway_type = {"either": "exclusive", "both": "parallel", "any": "inclusive"}[kind]
    (second,) = others
    default = f"{name}_in_{second.first}" if kind != "both" else None
    body = (
        first.body
        + second.body
        + gateway(f"{name}_in", gateway_type, default)
        + gateway(f"{name}_out", gateway_type)
    )
    body += flow(f"{name}_in", first.first, "go" if kind != "both" else None)
    body += flow(f"{name}_in", second.first) + flow(first.last, f"{name}_out")
    body += flow(second.last, f"{name}_out")
    return Block(body, f"{name}_in", f"{name}_out")


SHAPES = st.recursive(
    st.sampled_from([("do",), ("do",), ("script",)]),
    lambda inner: (
        st.tuples(st.just("then"), inner, inner)
        | st.tuples(st.just("either"), inner, inner)
        | st.tuples(st.just("both"), inner, inner)
        | st.tuples(st.just("any"), inner, inner)
        | st.tuples(st.just("loop"), st.tuples(st.just("then"), inner, st.just(("do",))))
    ),
    max_leaves=8,
)


def whole(shape: Any) -> str:
    """Return the body of a process of that shape; its loops repeat while `<activity>.ok`."""
    block = build(shape, count(1))
    return start() + block.body + end() + flow("start", block.first) + flow(block.last, "end")
