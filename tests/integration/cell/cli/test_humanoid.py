"""`handover humanoid` shows what humanoids do in simulation, and names what cannot be done."""

import pytest
from typer.testing import CliRunner

from handover.errors import UsageError
from handover_humanoid.command_line.humanoid import app


def said(*words: str) -> str:
    done = CliRunner().invoke(app, list(words), catch_exceptions=False, standalone_mode=False)
    return done.output


def test_humanoids_are_listed_with_their_hands() -> None:
    assert "coman        29 joints, 32.1 kg; chains: left_arm, right_arm" in said("list")


def test_a_short_walk_is_reported() -> None:
    output = said("walk", "--seconds", "1")
    assert output.startswith("1.0 s simulated")
    assert "of single support" in output


def test_a_walk_says_where_it_is_slower_than_asked() -> None:
    output = said("walk", "--speed", "-0.2", "--turn", "0.3", "--seconds", "1")
    assert "coman cannot step so far: 0.125 m/s at most, instead of 0.2 m/s" in output
    assert "0.25 rad/s at most, instead of 0.3 rad/s" in output


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["throw", "3", "0", "0.5"], "farthest place on that line"),
        (["throw", "3", "-0.3", "0.8"], r"cannot throw to \(3\.00, -0\.30, 0\.80\) m"),
        (["throw", "--hand", "left_hand", "3", "-0.3"], r"cannot throw to \(3\.00, -0\.30, 0\.50\) m"),
        (["throw", "-0.5"], r"it must be 0\.3 m or more in front"),
        (["throw", "--hand", "foot"], 'coman has no hand "foot"; it has: left_hand, right_hand'),
        (["walk", "--robot", "atlas"], 'there is no humanoid "atlas"'),
    ],
)
def test_what_cannot_be_done_is_named(words: list[str], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        said(*words)
