"""The heart rate of a person slows the humanoid: limits of human state only lower."""

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx

from services.whole_body_control.cycle.ports import PortReader
from tests.integration.whole_body_control.conftest import WITHIN_S, HumanoidCell
from tests.integration.whole_body_control.people import therapist_at
from tests.kit.waiting import wait_for

AHEAD_MPS = 0.1


def test_a_heart_that_beats_fast_slows_it_and_a_person_releases_the_stop(humanoid: HumanoidCell) -> None:
    humanoid.start()
    humanoid.cell.run("human_state")
    with httpx.Client(base_url=humanoid.cell.url("human_state"), trust_env=False, timeout=60) as body:

        def sense(bpm: float) -> None:
            settings = {"signals": ["heartRate"], "packet_s": 0.1, "rest_bpm": bpm}
            put("/sensors/strap", {"person": "aino", "driver": "simulated", "settings": settings})

        def put(path: str, given: Any) -> None:
            body.put(path, json=given).raise_for_status()

        ends = (datetime.now(UTC) + timedelta(hours=1)).isoformat()
        put("/people/aino", {"age": 40})
        purposes = ["live", "speedLimits"]
        put("/people/aino/consent", {"purposes": purposes, "ends": ends, "givenBy": "Aino"})
        sense(65)
        put("/people/aino/robots/coman-1", {})

        def reset() -> bool:
            body.post("/people/aino/limit/reset", json={"name": "Aino"})
            humanoid.http.post("/reset")
            limit: dict[str, Any] = humanoid.state()["limit"]
            return not limit["needsReset"] and limit["rule"].startswith("body-") and limit["factor"] > 0.25

        wait_for(reset, WITHIN_S, "the limit of a calm person")
        sense(150)
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
    humanoid.cell.kill("human_state")

    def is_free() -> bool:  # what was received before the end may still be read, and bring the source back
        assert humanoid.http.delete(f"/limits/{source['source']}").status_code in {204, 404}
        return humanoid.state()["limit"]["factor"] == 1.0

    wait_for(is_free, WITHIN_S, "the source is removed")
