"""Inputs of a person that wait for a slow reader."""

import asyncio

import orjson
from hypothesis import given
from hypothesis import strategies as st

from handover.control.latest_input import LatestInput


def text(seq: int, *, held: bool = True, gripper: str | None = None) -> str:
    return orjson.dumps({"seq": seq, "held": held, "gripper": gripper}).decode()


async def test_the_newest_input_replaces_older_ones() -> None:
    inputs = LatestInput()
    for seq in range(100):
        inputs.put(text(seq))
    assert await inputs.next() == text(99)
    inputs.put("no JSON")
    assert await inputs.next() == "no JSON"


async def test_a_release_is_sent_before_a_later_press_and_replaces_an_earlier_one() -> None:
    inputs = LatestInput()
    for given_text in (text(1), text(2, held=False), text(3), text(4)):
        inputs.put(given_text)
    assert [await inputs.next(), await inputs.next()] == [text(2, held=False), text(4)]
    inputs.put(text(5))
    inputs.put(text(6, held=False))
    assert await inputs.next() == text(6, held=False)


async def test_an_act_of_the_gripper_is_not_lost() -> None:
    inputs = LatestInput()
    inputs.put(text(1, gripper="close"))
    inputs.put(text(2))
    assert [await inputs.next(), await inputs.next()] == [text(1, gripper="close"), text(2)]


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([None, "open"])), max_size=40))
def test_few_inputs_wait_and_the_last_release_is_among_them(
    sent: list[tuple[bool, str | None]],
) -> None:
    async def passed_on() -> list[str]:
        inputs = LatestInput()
        for seq, (held, gripper) in enumerate(sent):
            inputs.put(text(seq, held=held, gripper=gripper))
        found: list[str] = []
        while inputs.has_some:
            found.append(await inputs.next())
        return found

    found = [orjson.loads(one) for one in asyncio.run(passed_on())]
    assert len(found) <= 3
    releases = [seq for seq, (held, gripper) in enumerate(sent) if not held and gripper is None]
    assert not releases or any(one["seq"] == releases[-1] for one in found)
