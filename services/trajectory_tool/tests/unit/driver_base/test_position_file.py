"""The joints of a simulated robot are known after a crash, if they belong to the stored state."""

from pathlib import Path

from handover_robots.driver_base.position_file import PositionFile

HOME = (0.0, -1.5)


def opened(path: Path, base: tuple[float, ...] = HOME) -> tuple[PositionFile, tuple[float, ...]]:
    file = PositionFile(path, base)
    return file, file.open()


def test_the_last_position_is_found_after_a_crash(tmp_path: Path) -> None:
    path = tmp_path / "cell" / "arm.joints"
    first, at = opened(path)
    assert at == HOME
    for number in range(5):
        first.write((0.1 * number, -1.0))
        _, at = opened(path)  # the first is still open, as after kill -9
        assert at == (0.1 * number, -1.0)
    second, _ = opened(path)
    second.write((9.0, 9.0))
    assert opened(path)[1] == (9.0, 9.0)


def test_a_position_of_another_stored_state_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "arm.joints"
    file, _ = opened(path)
    file.write((1.0, 1.0))
    assert opened(path, (0.5, 0.5))[1] == (0.5, 0.5)
    file.base = (0.5, 0.5)
    file.write((0.6, 0.6))
    assert opened(path, (0.5, 0.5))[1] == (0.6, 0.6)


def test_a_write_that_was_interrupted_leaves_the_position_before(tmp_path: Path) -> None:
    path = tmp_path / "arm.joints"
    file, _ = opened(path)
    file.write((1.0, 1.0))
    file.write((2.0, 2.0))
    content = bytearray(path.read_bytes())
    content[7] ^= 1  # the number before the content of the second write
    path.write_bytes(content)
    assert opened(path)[1] == (1.0, 1.0)


def test_the_file_of_a_robot_with_other_joints_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "arm.joints"
    file, _ = opened(path)
    file.write((1.0, 1.0))
    assert opened(path, (0.0, 0.0, 0.0))[1] == (0.0, 0.0, 0.0)
