"""`handover humanoid` shows what humanoids do in simulation, and names what cannot be done."""

import pytest
from typer.testing import CliRunner

from handover.cli.humanoid import app
from handover.errors import UsageError


def said(*words: str) -> str:
    done = CliRunner().invoke(app, list(words), catch_exceptions=False, standalone_mode=False)
    return done.output


def test_humanoids_are_listed_with_their_hands() -> None:
    assert "coman        29 joints, 32.1 kg; chains: left_arm, right_arm" in said("list")


def test_a_short_walk_is_reported() -> None:
    output = said("walk", "--seconds", "1")
    assert output.startswith("1.0 s simulated")
    assert "of single support" in output


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["throw", "3", "0", "0.5"], "farthest place on that line"),
        (["throw", "--hand", "foot"], 'coman has no hand "foot"; it has: left_hand, right_hand'),
        (["walk", "--robot", "atlas"], 'there is no humanoid "atlas"'),
    ],
)
def test_what_cannot_be_done_is_named(words: list[str], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        said(*words)
