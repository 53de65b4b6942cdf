"""The manual names the message types that exist, all of them."""

import re

from tests.kit.paths import REPOSITORY

MANUAL = REPOSITORY / "docs" / "reference" / "body-signal-formats.md"
FOLDER = REPOSITORY / "ros_fiware_bridge/handover_ros/messages" / "handover_human_msgs" / "msg"


def table(after: str) -> list[list[str]]:
    lines = MANUAL.read_text(encoding="utf-8").split(after, 1)[1].splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("|---"))
    rows = []
    for line in lines[start + 1 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_the_manual_lists_every_message_once() -> None:
    listed = [name for row in table("as a float, resolution") for name in re.findall(r"`(\w+)`", row[1])]
    assert sorted(listed) == sorted(file.stem for file in FOLDER.glob("*.msg"))


def test_each_type_of_ros4hc_has_one_of_ours() -> None:
    ours = {file.stem for file in FOLDER.glob("*.msg")}
    seen: list[str] = []
    for theirs, mapped, *_ in table("a release has 47 of them"):
        names = re.findall(r"`(\w+)`", mapped)
        assert names
        assert set(names) <= ours
        seen += re.findall(r"`(\w+)`", theirs)
    assert len(seen) == len(set(seen)) >= 47
