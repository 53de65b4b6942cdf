"""The message catalogue: the page has all English texts, and invalid messages are rejected."""

from pathlib import Path

import pytest

from handover_web.messages import ENGLISH, InvalidMessage, english, found_messages, serialized


def module(tmp_path: Path, *calls: str) -> Path:
    folder = tmp_path / "handover"
    folder.mkdir()
    (folder / "some.py").write_text("\n".join(calls), encoding="utf-8")
    return tmp_path


def test_the_english_texts_of_the_page_match_the_source() -> None:
    assert ENGLISH.read_text(encoding="utf-8") == serialized(english(found_messages())), (
        "run python -m handover_web.messages, and translate what is new in de/server.json and fi/server.json"
    )


def test_messages_are_extracted_and_nested_by_code(tmp_path: Path) -> None:
    root = module(
        tmp_path, 'message("arm.away", "the arm {robot} is away", robot=name)', 'message("b", "{{x}}")'
    )
    assert english(found_messages(root)) == {"arm": {"away": "the arm {{robot}} is away"}, "b": "{x}"}


def test_errors_that_are_translated_have_messages(tmp_path: Path) -> None:
    root = module(
        tmp_path, 'TaskFailed.translated("a", "{x}", x=1)', 'Problem.translated(404, "No", "b", "{y}", y=1)'
    )
    assert english(found_messages(root)) == {"a": "{{x}}", "b": "{{y}}"}


def test_the_descriptions_of_an_alert_are_extracted(tmp_path: Path) -> None:
    root = module(tmp_path, 'LOST = AlertType("task", "lost", {"alert.lost": "{task} is lost"})')
    assert english(found_messages(root)) == {"alert": {"lost": "{{task}} is lost"}}


@pytest.mark.parametrize(
    ("call", "why"),
    [
        ('message("a", f"no {name}")', "literal"),
        ('message(code, "x")', "literal"),
        ('Problem.translated(404, "No", "b", f"{y}")', "literal"),
        ('message("a", "{x:.3f}", x=1)', "plain name"),
        ('message("a", "{x.y}", x=1)', "plain name"),
        ('message("a", "{x}", y=1)', "no parameter x"),
        ('message("a", "{x}", **all)', "one by one"),
        ('message("a", "x"), message("a", "y")', "another text"),
        ('AlertType("task", {"a": text})', "literal"),
        ('AlertType("task", {"a": "{x:.3f}"})', "plain name"),
        ('message("a", "x"), message("a.b", "y")', "begins with"),
    ],
)
def test_untranslatable_messages_are_rejected(tmp_path: Path, call: str, why: str) -> None:
    with pytest.raises(InvalidMessage, match=why):
        english(found_messages(module(tmp_path, call)))
