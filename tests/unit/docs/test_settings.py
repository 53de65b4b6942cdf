"""The reference lists every setting once, under a subject."""

import re

import pytest

from docs.site.reference import ALL
from docs.site.setting_subjects import by_subject, subject_of
from handover.settings import PREFIX
from tests.kit.paths import REPOSITORY


def test_every_setting_is_listed_once() -> None:
    page = (REPOSITORY / "docs/reference/settings.md").read_text(encoding="utf-8")
    listed = re.findall(rf"^\| `{PREFIX}([A-Z_]+)` \|", page, re.MULTILINE)
    assert len(set(listed)) == len(listed)
    assert {name.lower() for name in listed} == {
        name for service in ALL for name in service.settings.model_fields
    }


def test_every_subject_has_a_setting() -> None:
    names = {name for service in ALL for name in service.settings.model_fields}
    assert [subject for subject, of_it in by_subject(names).items() if not of_it] == []


def test_the_longest_name_that_fits_decides() -> None:
    assert subject_of("device_leases") == "Processes and Tasks"
    assert subject_of("device_port") == "Devices"


def test_a_setting_without_a_subject_is_named() -> None:
    with pytest.raises(SystemExit, match=r"lamp_colour has no subject; .*setting_subjects\.py"):
        subject_of("lamp_colour")
