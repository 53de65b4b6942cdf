"""The heart rate of a person slows the humanoid: limits of human state only lower."""

import pytest

from handover_humanoid.cycle.ports import PortReader
from services.whole_body_control.tests.integration.conftest import WITHIN_S, HumanoidCell
from services.whole_body_control.tests.integration.people import heart_at, therapist_at
from tests.kit.waiting import wait_for

AHEAD_MPS = 0.1


@pytest.mark.nightly
def test_a_heart_that_beats_fast_slows_it_and_a_person_releases_the_stop(humanoid: HumanoidCell) -> None:
    humanoid.start()
    with heart_at(humanoid) as heart:
        wait_for(lambda: heart.allows(0.25), WITHIN_S, "the limit of a calm person")
        heart.beats(150)
        wait_for(lambda: "high" in humanoid.state()["limit"]["reason"], WITHIN_S, "the limit falls")
        wish = PortReader(humanoid.folder / "wish")

        def is_slow() -> bool:
            share = wish.value("speed_share") if "speed_share" in wish.names else 1.0
            return wish.read() and 0 < share * wish.value("ahead_mps") < 0.25 * AHEAD_MPS

        with therapist_at(humanoid) as therapist:
            therapist.hold({"ahead": AHEAD_MPS}, until=is_slow)
        assert 0 < humanoid.state()["limit"]["factor"] < 0.25
        (source,) = humanoid.http.get("/limits").json()
        assert 0 < source["fraction"] < 0.25
