"""Sizes that records of decisions state are compared with the tree."""

from pathlib import Path

import pytest

from docs.site import adr_figures


@pytest.fixture
def record(tmp_path: Path) -> Path:
    """A record beside a folder of 100 lines."""
    (tmp_path / "engine").mkdir()
    (tmp_path / "engine" / "one.py").write_text("a = 1\n" * 60)
    (tmp_path / "engine" / "two.py").write_text("b = 2\n" * 40)
    return tmp_path / "0001-engine.md"


@pytest.mark.parametrize("size", ["100", "90", "115"])
def test_a_size_may_differ_a_little(record: Path, size: str) -> None:
    record.write_text(f"[{size} lines](engine) are ours.")
    assert adr_figures.faults(record) == []


@pytest.mark.parametrize("size", ["80", "1,000"])
def test_another_size_is_reported_with_the_one_of_today(record: Path, size: str) -> None:
    record.write_text(f"[{size} lines](engine) are ours; 40 lines were theirs.")
    (fault,) = adr_figures.faults(record)
    assert fault.startswith(f"docs/adr/0001-engine.md: engine has 100 lines, not {size};")


def test_a_size_of_what_is_not_there_is_reported(record: Path) -> None:
    record.write_text("[100 lines](motor) are ours.")
    assert adr_figures.faults(record) == [
        "docs/adr/0001-engine.md: motor has no Python files; correct the link"
    ]


def test_the_records_state_sizes() -> None:
    records = [record.read_text(encoding="utf-8") for record in adr_figures.DECISIONS.glob("[0-9]*.md")]
    assert sum(len(adr_figures.FIGURE.findall(text)) for text in records) >= 6
