"""Streams of LSL have what the settings name and persons allow, and end with the consent and the service."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from services.human_state.tests.integration.conftest import Running, add_person
from tests.kit.waiting import scaled, until

pytest.importorskip("pylsl", reason="the extra [human-state] is not installed")

import pylsl

from handover.errors import UsageError
from handover.security.permissions import OWNER_GRANTS
from handover_body.exchange.lsl import LslInlet
from handover_body.monitoring.lsl_feed import LslFeed


async def streams_of(pseudonym: str, wait_s: float) -> list[pylsl.StreamInfo]:
    """Return the streams of a person that answer, after the first one or `wait_s`."""
    predicate = f"starts-with(source_id, 'handover {pseudonym} ')"
    return await asyncio.to_thread(pylsl.resolve_bypred, predicate, 1, wait_s)


@pytest.mark.nightly
async def test_an_inlet_gets_the_heart_rate_until_the_consent_is_withdrawn(running: Running) -> None:
    names = {"health_lsl_people": "aino", "health_lsl_signals": "heartRate"}
    async with running(grants=OWNER_GRANTS, **names) as rest:
        other = await add_person(rest, "eero", "live")
        made = await add_person(rest, "aino", "live")
        (stream, *_) = await streams_of(made["pseudonym"], scaled(60))
        assert stream.name() == "strap-aino heartRate"
        inlet = await asyncio.to_thread(LslInlet, stream, scaled(20))
        assert inlet.subject == made["pseudonym"]
        rates: list[float] = []

        def has_rates() -> bool:
            if (samples := inlet.pull()) is not None:
                # A strap has no rate before its first beats.
                rates.extend(rate for rate in samples.values[:, 0].tolist() if 30 < rate < 220)
            return len(rates) > 3

        await until(has_rates, scaled(60))
        inlet.close()
        assert await streams_of(other["pseudonym"], 1.0) == []

        (await rest.delete("/people/aino/consent")).raise_for_status()
        async with asyncio.timeout(scaled(60)):
            while await streams_of(made["pseudonym"], 1.0):
                await asyncio.sleep(0.1)

        again = await add_person(rest, "aino", "live")
        assert await streams_of(again["pseudonym"], scaled(60))
    assert await streams_of(again["pseudonym"], 1.0) == []


async def test_a_machine_without_accounts_sends_nothing_to_the_network(running: Running) -> None:
    with pytest.raises(UsageError, match="HANDOVER_HEALTH_LSL_PEOPLE"):
        async with running(health_lsl_people="aino"):
            pass


async def test_a_closed_feed_taps_nobody_any_more() -> None:
    monitors: dict[str, Any] = {}
    feed = LslFeed(SimpleNamespace(monitors=monitors), ("aino",), ())  # type: ignore[arg-type] - what it reads
    feed.close()
    monitors["aino"] = SimpleNamespace(taps=set(), person=SimpleNamespace(pseudonym="p-1", name="aino"))
    await asyncio.wait_for(feed.run(), scaled(30))
    assert monitors["aino"].taps == set()
