"""Destinations: which addresses may be notified."""

import asyncio

import pytest

from handover.errors import Problem
from services.context_broker.settings import BrokerSettings
from services.context_broker.subscriptions.destinations import Destinations, Refused, is_loopback
from services.context_broker.subscriptions.http_sender import HttpSender, SendError

LINK_LOCAL = ["169.254.169.254", "169.254.0.1", "fe80::1", "::ffff:169.254.169.254"]
LOOPBACK = ["127.0.0.1", "127.8.8.8", "::1", "0.0.0.0", "::", "::ffff:127.0.0.1"]
ELSEWHERE = ["10.0.0.5", "192.168.1.4", "8.8.8.8", "2001:db8::1", "fd00::1"]


@pytest.mark.parametrize("host", LINK_LOCAL)
def test_link_local_addresses_are_closed_unless_a_setting_opens_them(host: str) -> None:
    assert "HANDOVER_BROKER_NOTIFY_LINK_LOCAL" in (Destinations().fault_of(host) or "")
    assert Destinations(link_local=True).fault_of(host) is None


@pytest.mark.parametrize("host", LOOPBACK)
def test_the_own_machine_is_closed_for_a_broker_that_others_reach(host: str) -> None:
    assert Destinations().fault_of(host) is None
    assert "HANDOVER_BROKER_NOTIFY_LOOPBACK" in (Destinations(loopback=False).fault_of(host) or "")


@pytest.mark.parametrize("host", ELSEWHERE)
def test_other_addresses_are_open(host: str) -> None:
    assert Destinations(loopback=False).fault_of(host) is None


@pytest.mark.parametrize("host", ["localhost", "127.1", "2130706433", "0x7f.1"])
def test_names_and_odd_spellings_are_judged_by_where_they_lead(host: str) -> None:
    with pytest.raises(Refused, match="own machine"):
        asyncio.run(Destinations(loopback=False).resolved(host, 80))
    with pytest.raises(Problem) as refused:
        asyncio.run(Destinations(loopback=False).require_open(host, "the endpoint"))
    assert refused.value.status == 400


def test_a_name_that_nobody_knows_yet_is_let_pass_and_fails_when_used() -> None:
    asyncio.run(Destinations().require_open("nobody.invalid", "the endpoint"))
    with pytest.raises(SendError):
        asyncio.run(HttpSender(Destinations()).post("http://nobody.invalid/", [], b"", 5))


def test_a_closed_address_is_refused_again_when_it_is_used() -> None:
    with pytest.raises(SendError, match="HANDOVER_BROKER_NOTIFY_LOOPBACK"):
        asyncio.run(HttpSender(Destinations(loopback=False)).post("http://127.0.0.1:9/", [], b"", 5))


@pytest.mark.parametrize(
    ("host", "told", "open_"),
    [
        ("127.0.0.1", None, True),
        ("localhost", None, True),
        ("::1", None, True),
        ("0.0.0.0", None, False),
        ("192.168.1.4", None, False),
        ("0.0.0.0", True, True),
        ("127.0.0.1", False, False),
    ],
)
def test_loopback_is_open_for_a_broker_on_loopback_or_when_it_is_set(
    host: str, told: bool | None, open_: bool
) -> None:
    settings = BrokerSettings.load(host=host, broker_notify_loopback=told)
    assert settings.destinations().loopback is open_
    assert is_loopback("127.0.0.1")
    assert not is_loopback("my-host")
