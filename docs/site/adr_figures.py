"""Compares the sizes that records of decisions state with the tree; part of `make lint`.

    python -m docs.site.adr_figures

A record marks a size of today as a link to what it counts: `[3,960 lines](../../path/of/a/folder)`. Counted
are the lines of the Python files there. A size that differs by more than `TOLERANCE` is reported; the record
gets the new one, after a look at whether the decision still holds. Sizes of the past, such as
those of a rejected alternative, are plain text and are not compared.
"""

import re
from pathlib import Path

DECISIONS = Path(__file__).parents[1] / "adr"
FIGURE = re.compile(r"\[(?P<lines>[\d,]+) lines\]\((?P<target>[^)\s#]+)\)")
TOLERANCE = 0.15


def faults(record: Path) -> list[str]:
    """Return what is wrong with the sizes of a record, a line for each."""
    name, found = f"docs/adr/{record.name}", []
    for figure in FIGURE.finditer(record.read_text(encoding="utf-8")):
        target = (record.parent / figure["target"]).resolve()
        files = [target] if target.is_file() else sorted(target.rglob("*.py"))
        if not files:
            found.append(f"{name}: {figure['target']} has no Python files; correct the link")
            continue
        stated = int(figure["lines"].replace(",", ""))
        counted = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        if abs(counted - stated) > TOLERANCE * stated:
            found.append(
                f"{name}: {figure['target']} has {counted:,} lines, not {stated:,}; correct the figure, and "
                "read whether the decision still holds"
            )
    return found


def main() -> None:
    """Fail if a size differs."""
    wrong = [fault for record in sorted(DECISIONS.glob("[0-9]*.md")) for fault in faults(record)]
    if wrong:
        raise SystemExit("\n".join(wrong))


if __name__ == "__main__":
    main()
