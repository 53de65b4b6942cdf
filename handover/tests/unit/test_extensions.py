"""Extensions are found by name; one that cannot be used says why."""

from pathlib import Path

import pytest

from handover.extensions import ExtensionPoint, UnknownExtension

GROUP = "handover.test_things"
POINT = ExtensionPoint("thing", GROUP, {"own": "pathlib:Path"})


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that registers three things."""
    information = tmp_path / "things-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: things\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(
        f"[{GROUP}]\nother = json:dumps\nbroken = no_such_module:thing\nown = json:loads\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures("installed")
def test_names_are_our_own_first() -> None:
    assert POINT.names() == ["own", "broken", "other"]


@pytest.mark.usefixtures("installed")
def test_package_adds_a_name_and_cannot_replace_ours() -> None:
    assert POINT.load("other")([1]) == "[1]"
    assert POINT.load("own") is Path


@pytest.mark.usefixtures("installed")
def test_package_that_cannot_be_imported_is_named() -> None:
    with pytest.raises(UnknownExtension, match=r'thing "broken" \(no_such_module:thing\) cannot be loaded'):
        POINT.load("broken")


def test_unknown_name_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(UnknownExtension, match=f'no thing "none"; there are: own. .* "{GROUP}"'):
        POINT.load("none")
