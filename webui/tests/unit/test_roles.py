"""A role is defined in one file; the page has its table and its texts from there."""

from pathlib import Path
from types import ModuleType
from typing import Any

from handover.security import permissions
from handover.security.permissions import Permission, Role
from handover_web import roles
from handover_web.messages import ENGLISH

LANGUAGES = {folder.name for folder in ENGLISH.parents[1].iterdir() if folder.is_dir()}
GUARD = """\
    GUARD = (
        "guard",
        _VIEWER | {Permission.ACKNOWLEDGE_ALERTS},
        {
            "en": ("Guard", "May also acknowledge alerts."),
            "de": ("Wache", "Darf außerdem Alarme quittieren."),
            "fi": ("Vartija", "Saa lisäksi kuitata hälytyksiä."),
        },
    )
"""


def edited(before: str, added: str) -> Any:
    """Return the module of the roles as if `added` stood in its file before the line `before`."""
    source = Path(permissions.__file__).read_text(encoding="utf-8")
    assert source.count(before) == 1
    module = ModuleType(permissions.__name__)
    exec(compile(source.replace(before, added + before), permissions.__file__, "exec"), vars(module))
    return module


def test_the_files_of_the_page_are_those_of_the_roles() -> None:
    roles.main(["--check"])


def test_every_role_has_a_name_and_a_sentence_in_every_language() -> None:
    for role in Role:
        assert role.texts.keys() == LANGUAGES
        assert all(name and may.endswith(".") for name, may in role.texts.values())


def test_a_role_that_is_added_to_one_file_is_held_granted_and_shown() -> None:
    module = edited("    PERFORMER = (\n", GUARD)
    guard = module.Role("guard")
    assert module.is_allowed([module.Grant(guard)], Permission.ACKNOWLEDGE_ALERTS)
    assert not module.is_allowed([module.Grant(guard)], Permission.PERFORM_TASKS)
    assert module.Grant(guard) in module.OWNER_GRANTS
    files = roles.files(module.Role)
    table = files["session/roles.json"]
    assert "guard" in table["roles"]
    holding = {permission for permission, holders in table["having"].items() if "guard" in holders}
    assert holding == {Permission.READ, Permission.ACKNOWLEDGE_ALERTS}
    assert [files[f"i18n/{language}/roles.json"]["name"]["guard"] for language in ("en", "de", "fi")] == [
        "Guard", "Wache", "Vartija",
    ]  # fmt: skip


def test_the_roles_of_programs_are_not_offered_to_people() -> None:
    assert {*roles.files(Role)["session/roles.json"]["roles"]} == {*Role} - {Role.PERFORMER, Role.SERVICE}
