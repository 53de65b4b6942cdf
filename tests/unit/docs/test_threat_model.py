"""The threat model names tests that exist."""

import itertools
import re

from tests.kit.paths import REPOSITORY, TEST_FOLDERS

NAMED = re.compile(r"`(test_\w+\.py)(?:::(test_\w+))?`")


def test_every_test_that_the_threat_model_names_exists() -> None:
    page = (REPOSITORY / "docs/threat-model.md").read_text(encoding="utf-8")
    files: dict[str, str] = {}
    for file in itertools.chain.from_iterable(folder.rglob("test_*.py") for folder in TEST_FOLDERS):
        files[file.name] = files.get(file.name, "") + file.read_text(encoding="utf-8")
    named = NAMED.findall(page)
    assert len(named) > 30
    missing = [
        f"{file}::{test}" for file, test in named if file not in files or f"def {test}" not in files[file]
    ]
    assert not missing


def test_every_threat_has_a_test() -> None:
    page = (REPOSITORY / "docs/threat-model.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if re.match(r"\| [STRIDE] \|", line)]
    assert len(rows) > 25
    assert not [row for row in rows if not NAMED.search(row)]
