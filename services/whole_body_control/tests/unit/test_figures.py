"""The figures of the paper are drawn from runs, with what was measured in them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handover_humanoid.behaviours.simulated_person import Lead
from handover_humanoid.figures import draw_led_walk, draw_throws
from handover_humanoid.robots import humanoid

COMAN = humanoid("coman")


def colours(file: Path) -> int:
    with Image.open(file) as picture:
        return len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0))


@pytest.mark.nightly
def test_throws_and_the_times_of_the_solver_are_drawn(tmp_path: Path) -> None:
    figure = draw_throws(COMAN, tmp_path / "throws.png", throws=1)
    assert len(figure.errors_mm) == len(COMAN.grips)
    assert figure.errors_mm.max() < 100
    assert len(figure.solve_us) > 200
    assert figure.solve_us.min() > 0
    assert colours(tmp_path / "throws.png") > 20


@pytest.mark.nightly
def test_a_led_walk_is_drawn(tmp_path: Path) -> None:
    script = [Lead(2.0, ahead_m=0.18), Lead(0.5)]
    record = draw_led_walk(COMAN, tmp_path / "walk.png", "lead", script=script)
    assert record.script == tuple(script)
    assert len(record.time_s) == 250
    assert colours(tmp_path / "walk.png") > 20
