"""The messages of all services: the page has their English, and what cannot be translated is refused."""

from pathlib import Path

import pytest

from webui.messages import ENGLISH, WrongMessage, english, found_messages, written


def module(tmp_path: Path, *calls: str) -> Path:
    folder = tmp_path / "handover"
    folder.mkdir()
    (folder / "some.py").write_text("\n".join(calls), encoding="utf-8")
    return tmp_path


def test_the_page_has_the_english_of_the_source() -> None:
    assert ENGLISH.read_text(encoding="utf-8") == written(english(found_messages())), (
        "run python -m webui.messages, and translate what is new in de/server.json and fi/server.json"
    )


def test_messages_are_found_and_nested_by_their_codes(tmp_path: Path) -> None:
    root = module(
        tmp_path, 'message("arm.away", "the arm {robot} is away", robot=name)', 'message("b", "{{x}}")'
    )
    assert english(found_messages(root)) == {"arm": {"away": "the arm {{robot}} is away"}, "b": "{x}"}


@pytest.mark.parametrize(
    ("call", "why"),
    [
        ('message("a", f"no {name}")', "literal"),
        ('message(code, "x")', "literal"),
        ('message("a", "{x:.3f}", x=1)', "plain name"),
        ('message("a", "{x.y}", x=1)', "plain name"),
        ('message("a", "{x}", y=1)', "no parameter x"),
        ('message("a", "{x}", **all)', "one by one"),
        ('message("a", "x"), message("a", "y")', "another text"),
        ('message("a", "x"), message("a.b", "y")', "begins with"),
    ],
)
def test_what_cannot_be_translated_is_refused(tmp_path: Path, call: str, why: str) -> None:
    with pytest.raises(WrongMessage, match=why):
        english(found_messages(module(tmp_path, call)))
