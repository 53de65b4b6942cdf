"""A result keeps what JSON can express; a number that is none is named, and never becomes null."""

import math
from typing import Any

import orjson
from hypothesis import given
from hypothesis import strategies as st

from handover.job import finite_outputs
from handover_datamodels.numbers import not_finite_place

_NAMES = st.text("abc", min_size=1, max_size=3)
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_NAMES, inner, max_size=3),
    max_leaves=8,
)


def at(value: Any, place: str) -> Any:
    for part in place.split(".") if place else ():
        value = value[int(part)] if isinstance(value, list) else value[part]
    return value


@given(st.dictionaries(_NAMES, _VALUES, max_size=4))
def test_each_output_is_sent_as_it_is_or_named(outputs: dict[str, Any]) -> None:
    sent = finite_outputs(outputs)
    read: dict[str, Any] = orjson.loads(orjson.dumps(sent))
    assert {name: read[name] for name in outputs if name in read} == {
        name: outputs[name] for name in outputs if name in read
    }
    for name in outputs.keys() - read.keys():
        place = not_finite_place(outputs[name])
        assert place is not None
        assert not math.isfinite(at(outputs[name], place))
        assert f"{name}.{place}".rstrip(".") in read["reason"]


def test_the_reason_of_a_failed_task_stays() -> None:
    assert finite_outputs({"reason": "the part slipped", "force": math.inf}) == {"reason": "the part slipped"}
