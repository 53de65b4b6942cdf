"""The threat model names tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
NAMED = re.compile(r"`(test_\w+\.py)(?:::(test_\w+))?`")


def test_every_test_that_the_threat_model_names_exists() -> None:
    page = (ROOT / "docs/threat-model.md").read_text(encoding="utf-8")
    files: dict[str, str] = {}
    for file in (ROOT / "tests").rglob("test_*.py"):
        files[file.name] = files.get(file.name, "") + file.read_text(encoding="utf-8")
    named = NAMED.findall(page)
    assert len(named) > 30
    missing = [
        f"{file}::{test}" for file, test in named if file not in files or f"def {test}" not in files[file]
    ]
    assert not missing


def test_every_threat_has_a_test() -> None:
    page = (ROOT / "docs/threat-model.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if re.match(r"\| [STRIDE] \|", line)]
    assert len(rows) > 25
    assert not [row for row in rows if not NAMED.search(row)]
