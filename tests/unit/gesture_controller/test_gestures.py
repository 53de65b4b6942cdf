"""The 21 gestures of M2O2P, their codes, and the commands they stand for."""

from services.gesture_controller.gestures import (
    M2O2P_GESTURES,
    Commands,
    Gestures,
    default_commands,
)


def test_there_are_21_gestures_with_a_code_each() -> None:
    assert len(M2O2P_GESTURES) == 21
    assert len(set(M2O2P_GESTURES.values())) == 21


def test_a_gesture_is_called_after_its_straight_fingers() -> None:
    fingers = ("thumb", "index", "middle", "ring", "little")
    for name, code in M2O2P_GESTURES.items():
        straight = {finger for finger, state in zip(fingers, code, strict=True) if state == "0"}
        if name == "Horns":
            assert straight == {"index", "little"}
        elif name == "Thumbs up":
            assert straight == {"thumb"}
        else:
            assert straight == {finger for finger in fingers if finger in name.lower()}, name


def test_every_gesture_has_one_command_by_default() -> None:
    commands = default_commands(Gestures(M2O2P_GESTURES))
    assert sorted(commands.ids.values()) == list(range(1, 22))
    assert set(commands.ids) == set(M2O2P_GESTURES)
    assert commands.gestures[3] == "Thumbs up"


def test_a_gesture_is_found_whatever_its_capitals() -> None:
    gestures = Gestures(M2O2P_GESTURES)
    assert gestures.find("thumbs UP") == "Thumbs up"
    assert gestures.find("Vulcan salute") is None


def test_a_misspelt_gesture_brings_up_the_one_meant() -> None:
    assert gestures_like("Thumb up") == 'did you mean "Thumbs up"'
    assert gestures_like("xyz").startswith("the gestures are Horns")


def gestures_like(name: str) -> str:
    return Gestures(M2O2P_GESTURES).like(name)


def test_a_persons_own_gesture_takes_the_place_of_the_maps() -> None:
    commands = Commands({1: "Horns", 2: "Thumbs up"}).with_own({1: "Ring straight"})
    assert commands.gestures == {1: "Ring straight", 2: "Thumbs up"}
    assert "Horns" not in commands.ids
