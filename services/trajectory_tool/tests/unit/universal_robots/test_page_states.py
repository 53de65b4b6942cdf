"""The page has a word for each state of a controller, in each language."""

import json

import pytest

from handover_ur.states import RobotMode, UrSafetyStatus
from tests.kit.paths import REPOSITORY


@pytest.mark.parametrize("language", ["en", "de", "fi"])
def test_the_page_names_each_mode_and_safety_state(language: str) -> None:
    file = REPOSITORY / f"webui/app/src/i18n/{language}/system.json"
    words = json.loads(file.read_text(encoding="utf-8"))["limit"]["state"]
    assert words.keys() == {*RobotMode.__members__, *UrSafetyStatus.__members__}
    assert all(words.values())
