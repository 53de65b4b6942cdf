"""`handover device list` shows the state of a device by the rule of the page."""

from itertools import product
from typing import Any

import pytest

from handover_devices.command_line.device import state_of

STALE: tuple[tuple[bool, ...], ...] = ((), (True,), (False,), (True, False))


@pytest.mark.parametrize(
    ("is_connected", "stale", "state"), list(product((True, False), STALE, (None, "busy")))
)
def test_a_device_is_away_without_a_connection_and_without_fresh_values(
    is_connected: bool, stale: tuple[bool, ...], state: str | None
) -> None:
    values = {f"v{number}": {"value": 1.0, "stale": one} for number, one in enumerate(stale)}
    device: dict[str, Any] = {"connected": is_connected, "values": values, "state": state}
    is_here = is_connected or False in stale
    assert state_of(device) == ((state or "connected") if is_here else "away")
