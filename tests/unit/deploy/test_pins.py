"""Actions are pinned by commit and images by digest, or the documentation lists them as unpinned."""

import re
from collections.abc import Iterator
from pathlib import Path

from tests.kit.paths import REPOSITORY

WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))
DOCUMENT = (REPOSITORY / "docs" / "contributing" / "release.md").read_text()
PINNED, UNPINNED = DOCUMENT.split("## What is pinned")[1].split("Unpinned, because")
IMAGES_IN = (
    *WORKFLOWS,
    REPOSITORY / "docker-compose.yml",
    REPOSITORY / "Dockerfile",
    REPOSITORY / "deploy" / "ros" / "Dockerfile",
    *(REPOSITORY / "deploy" / "kubernetes").glob("*.yaml"),
)


def images() -> Iterator[str]:
    """Yield the images of others; ours are built here."""
    for file in IMAGES_IN:
        for found in re.findall(r"^\s*(?:image:|ARG BASE=)\s*(\S.*)$", Path(file).read_text(), re.MULTILINE):
            name = re.sub(r"\$\{[A-Z_]+:-([^}]*)\}", r"\1", found.strip())
            if not name.startswith("handover"):
                yield name


def test_every_action_has_a_verified_commit_or_is_listed() -> None:
    used = {
        (action, version, comment)
        for file in WORKFLOWS
        for action, version, comment in re.findall(r"uses: ([^@\s]+)@(\S+)(?: # (\S+))?", file.read_text())
    }
    assert used
    for action, version, comment in used:
        if re.fullmatch(r"[0-9a-f]{40}", version):
            assert f"`{action}` {comment} | `{version}`" in PINNED
        else:
            assert f"`{action}@{version}`" in UNPINNED


def test_every_image_has_a_digest_or_is_listed() -> None:
    found = set(images())
    assert len(found) >= 8
    assert {name for name in found if "@sha256:" not in name and f"`{name}`" not in UNPINNED} == set()


def test_nothing_is_listed_that_is_not_used() -> None:
    text = "\n".join(Path(file).read_text() for file in IMAGES_IN)
    for name in re.findall(r"`([^`]+[@:][^`]+)`", UNPINNED):
        assert name in text, name
