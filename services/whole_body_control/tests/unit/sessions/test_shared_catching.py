"""The page shows what the service counts: the smallest distance of the ball from a palm."""

from typing import Any, cast

import numpy as np
import orjson
import pytest

from handover_humanoid.sessions.catching import CatchDetector, CatchRules, HandSample
from tests.kit.paths import REPOSITORY

SHARED = orjson.loads((REPOSITORY / "webui/app/src/humanoid/vr/catching.fixture.json").read_bytes())
PALM = np.array([0.8, 0.0, 0.7])


def test_the_reach_of_a_palm_is_that_of_the_page() -> None:
    assert SHARED["radiusM"] == CatchRules().radius_m


@pytest.mark.parametrize("case", cast("list[dict[str, Any]]", SHARED["cases"]))
def test_a_ball_comes_as_near_as_the_page_shows_it(case: dict[str, Any]) -> None:
    rules = CatchRules(ground_m=-5.0)
    detector = CatchDetector(0.0, rules)
    outcome = None
    for time_s, apart in ((0.01, case["before"]), (0.02, case["after"]), (9.0, case["after"])):
        outcome = outcome or detector.update(time_s, PALM + np.array(apart), {"left": HandSample(PALM)})
    assert outcome is not None
    assert (outcome.result == "caught") == case["isCaught"]
    assert outcome.closest_m == pytest.approx(case["closestM"], abs=1e-9)
