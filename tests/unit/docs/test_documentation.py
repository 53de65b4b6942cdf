"""Links, commands and examples of the documentation are right."""

import functools
import importlib.util
import itertools
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from docs.site.hooks import INCLUDED
from glove_sdk_bridge.command_line import parse
from handover.command_line.commands import commands_of as installed_commands
from handover.command_line.main import app
from handover_bpmn.notation.file import read_bpmn
from tests.kit.paths import REPOSITORY

DOCUMENTS = sorted(
    [
        *REPOSITORY.glob("*.md"),
        *(REPOSITORY / "docs").rglob("*.md"),
        *(REPOSITORY / "examples").rglob("*.md"),
        *(REPOSITORY / path for path in INCLUDED),
    ]
)
FENCE = re.compile(r"^[ >]*```(?P<language>\w*)\n(?P<content>.*?)^[ >]*```", re.MULTILINE | re.DOTALL)
HERE_DOCUMENT = re.compile(r"<<(?P<end>[A-Z]+)$.*?^(?P=end)$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`[^`\n]+`")
LINK = re.compile(r"\[[^\]]*\]\((?P<target>[^)\s]+)\)")
MAX_README_LINES = 150
NOT_OURS = {
    "apt", "cd", "curl", "docker", "export", "find", "git", "gh", "mosquitto_pub", "pip", "python3", "sed",
    "sudo",
}  # fmt: skip
"""Programs whose words are not checked."""


def name(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name)
def test_every_link_leads_somewhere(document: Path) -> None:
    text = CODE.sub("", FENCE.sub("", document.read_text(encoding="utf-8")))
    dead = []
    for link in LINK.finditer(text):
        target, _, anchor = link["target"].partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        path = (document.parent / target).resolve() if target else document
        is_dead = not path.exists() or (path.suffix == ".md" and anchor and anchor not in anchors(path))
        if is_dead:
            dead.append(link["target"])
    assert dead == []


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings of a document, as MkDocs and GitHub make them."""
    text = FENCE.sub("", document.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def commands() -> Iterator[tuple[str, str]]:
    """Yield the document and the text of each command in a block of the language sh."""
    for document in DOCUMENTS:
        for block in FENCE.finditer(document.read_text(encoding="utf-8")):
            if block["language"] == "sh":
                for command in commands_of(block["content"]):
                    yield name(document), command


def commands_of(script: str) -> Iterator[str]:
    """Yield the commands of a script; a quoted argument may have several lines, as may a here-document."""
    unfinished = ""
    for line in HERE_DOCUMENT.sub("", script.replace("\\\n", " ")).splitlines():
        text = unfinished + line.strip()
        try:
            words = shlex.split(text, comments=True)
        except ValueError:  # a quote is open
            unfinished = f"{text}\n"
            continue
        unfinished = ""
        for is_operator, part in itertools.groupby(words, lambda word: word in {"&&", "&", "|"}):
            if not is_operator:
                yield shlex.join(itertools.takewhile(lambda word: word != ">", part))


@pytest.mark.parametrize(("document", "command"), [*commands()])
def test_every_command_exists(document: str, command: str) -> None:
    words = shlex.split(command)
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    if not words:
        return  # only variables
    program = words[0].removeprefix(".venv/bin/")
    if program == "python" and words[1].endswith(".py"):
        return  # a file that the reader has saved
    if program in {"python", "python3"} and words[1:2] == ["-m"]:
        program, words = words[2], words[2:]
    if program == "handover":
        check_handover(words[1:])
    elif program == "glove_sdk_bridge":
        parse(words[1:], program)
    elif program.startswith("handover_"):
        assert importlib.util.find_spec(program) is not None, program
    elif program == "make":
        makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
        for target in words[1:]:
            assert "=" in target or re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), target
    else:
        assert program in {*NOT_OURS, "venv", "pytest"} or program.endswith((".py", "/run")), program


def check_handover(words: list[str]) -> None:
    """Fail if the command line does not accept `words`."""
    if words[0] == "glove" and words[1] != "token":
        if words[1] != "udp":  # of an example
            parse(words[1:], "handover glove")
        return
    known, at = handover_commands(), 0
    command = known[()]
    while hasattr(command, "commands") and not (command.invoke_without_command and words[at].startswith("-")):
        at += 1
        assert tuple(words[:at]) in known, f"no command {words[:at]}"
        command = known[tuple(words[:at])]
    command.make_context("handover", list(words[at:]))


@functools.cache
def handover_commands() -> dict[tuple[str, ...], Any]:
    return dict(installed_commands(app))


TUTORIALS = [
    ("first-cell.md", "check-part", ["go_home", "check_part"]),
    ("first-component.md", "light-up", ["light"]),
]


@pytest.mark.parametrize(("_", "process", "activities"), TUTORIALS)
def test_the_process_of_a_tutorial_can_be_deployed(_: str, process: str, activities: list[str]) -> None:
    file = REPOSITORY / "docs" / "tutorials" / f"{process}.bpmn"
    (definition,) = read_bpmn(file.read_bytes()).definitions
    assert definition.name == process
    assert list(definition.activities()) == activities


@pytest.mark.parametrize(("page", "process", "_"), TUTORIALS)
def test_a_tutorial_shows_a_part_of_its_process(page: str, process: str, _: list[str]) -> None:
    tutorial = (REPOSITORY / "docs" / "tutorials" / page).read_text(encoding="utf-8")
    shown = tutorial.split("```xml\n", 1)[1].split("```", 1)[0]
    file = (REPOSITORY / "docs" / "tutorials" / f"{process}.bpmn").read_text(encoding="utf-8")
    assert [line.strip() for line in shown.splitlines() if line.strip() not in file] == []


def test_files_that_the_architecture_names_exist() -> None:
    architecture = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:services|handover|ros_fiware_bridge|webui|docs)/[\w/.]+)`", architecture)
    assert len(named) >= 40
    assert [path for path in named if not (REPOSITORY / path).exists()] == []


def test_the_picture_of_the_architecture_has_every_package() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    architecture = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    drawn = re.findall(r"\[\"<b>(\w+)</b>", architecture)
    assert sorted(drawn) == sorted(project["tool"]["importlinter"]["root_packages"])


def test_readme_is_short_and_says_what_fast_dds_needs_on_the_first_screen() -> None:
    lines = (REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_README_LINES
    assert "Fast DDS" in " ".join(lines[:14])


def test_every_record_of_a_decision_has_its_own_number() -> None:
    numbers = [path.name[:4] for path in (REPOSITORY / "docs" / "adr").glob("[0-9]*.md")]
    assert len(numbers) == len(set(numbers))
