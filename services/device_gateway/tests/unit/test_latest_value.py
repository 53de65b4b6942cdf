"""The latest values and events of a device: when a value is stale, and what is written to the broker."""

import pytest

from handover_devices.model.description import DeviceDescription, DeviceKind
from handover_devices.registry.device import Device, LatestValue
from handover_devices.registry.entities import device_entity
from handover_devices.settings import GatewaySettings
from handover_devices.storage.device_store import StoredDevice


def sent_every(period_s: float, times: int = 20) -> LatestValue:
    value = LatestValue(0.0, 0.0)
    for number in range(1, times):
        value.replace(number * period_s, 1.0)
    return value


@pytest.mark.parametrize(("period_s", "stale_after_s"), [(0.1, 10.0), (1.0, 10.0), (60.0, 180.0)])
def test_a_value_is_stale_after_three_of_its_periods_and_ten_seconds(
    period_s: float, stale_after_s: float
) -> None:
    value = sent_every(period_s)
    assert not value.is_stale(value.t + 0.99 * stale_after_s)
    assert value.is_stale(value.t + 1.01 * stale_after_s)


def test_the_first_value_is_stale_after_a_minute() -> None:
    assert not LatestValue(0.0, 1.0).is_stale(59.0)
    assert LatestValue(0.0, 1.0).is_stale(61.0)


def test_a_long_pause_counts_little_in_the_period() -> None:
    value = sent_every(1.0)
    value.replace(value.t + 86_400.0, 1.0)
    assert value.is_stale(value.t + 11.0)
    replayed = LatestValue(0.0, 1.0)
    replayed.replace(86_400.0, 2.0)
    assert replayed.is_stale(replayed.t + 901.0)


def test_a_large_integer_in_an_event_reaches_every_broker_as_the_same_number() -> None:
    device = Device(StoredDevice("meter", DeviceDescription(kind=DeviceKind.SENSOR), None, 0, 0))
    device.event = ("reading", {"uptimeMs": 1_764_408_000_000, "pulses": 3}, 1_770_000_000.0)
    data = device_entity(GatewaySettings(_env_file=None), device)["lastEvent"]["value"]["data"]
    assert data == {"uptimeMs": 1_764_408_000_000, "pulses": 3}
    assert [type(each) for each in data.values()] == [float, int]
