"""Settings that could not work are refused in one line."""

import pytest

from handover.errors import UsageError
from handover_gloves.settings import ControllerSettings


@pytest.mark.parametrize(
    ("host", "local"),
    [
        *((host, False) for host in ("0.0.0.0", "::", "192.168.1.5", "cell-3.example.org")),
        *((host, True) for host in ("127.0.0.1", "::1", "localhost", "127.1.2.3")),
    ],
)
def test_an_address_is_local_if_only_this_machine_reaches_it(host: str, local: bool) -> None:
    assert ControllerSettings.load(glove_host=host).is_local is local


def test_a_gesture_is_announced_before_it_counts() -> None:
    with pytest.raises(UsageError, match=r"announce_ms \(1500\) must be less than confirm_ms \(1500\)"):
        ControllerSettings.load(announce_ms=1500)


def test_the_token_is_not_shown() -> None:
    assert "hush" not in repr(ControllerSettings.load(glove_token="hush"))


def test_the_broker_gets_an_address_it_can_reach() -> None:
    assert ControllerSettings.load(controller_port=5).notify_url == "http://127.0.0.1:5/notifications"
    assert ControllerSettings.load(host="0.0.0.0", controller_port=5).notify_url.startswith("http://127.")
    elsewhere = ControllerSettings.load(controller_url="http://gestures:54210/")
    assert elsewhere.notify_url == "http://gestures:54210/notifications"
