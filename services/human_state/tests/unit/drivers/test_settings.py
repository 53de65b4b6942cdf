"""Secrets among the settings of a driver."""

from pydantic import SecretStr

from handover_body.drivers.base import HIDDEN, DriverSettings


class CloudSettings(DriverSettings):
    user: str
    password: SecretStr


def test_a_secret_is_hidden_and_kept_when_it_comes_back_hidden() -> None:
    stored = {"user": "aino", "password": "pw"}
    shown = CloudSettings.shown(stored)
    assert shown == {"user": "aino", "password": HIDDEN}
    assert CloudSettings.completed({**shown, "user": "eero"}, stored) == {"user": "eero", "password": "pw"}
    assert CloudSettings.completed({**shown, "password": "new"}, stored)["password"] == "new"


def test_text_that_looks_hidden_is_no_secret_of_another_setting() -> None:
    assert CloudSettings.completed({"user": HIDDEN}, {"user": "aino"}) == {"user": HIDDEN}
