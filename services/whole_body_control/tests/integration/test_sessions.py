"""Sessions of persons: what is kept of them, and what ends, pauses and deletes them."""

from typing import Any

import pytest

from services.whole_body_control.tests.integration.conftest import WITHIN_S, HumanoidCell
from services.whole_body_control.tests.integration.people import THROW_S, catching_patient, resume
from tests.kit.waiting import wait_for


@pytest.mark.nightly
def test_what_cannot_be_a_session_is_refused_with_the_reason(humanoid: HumanoidCell) -> None:
    humanoid.start()
    asked = {"application": "juggling", "goal": {"throws": 1}}
    assert "goal has throws" in humanoid.post("/sessions", {**asked, "goal": {}}, 422)["detail"]
    assert "target.0" in humanoid.post("/sessions", {**asked, "target": [9, 0, 0]}, 422)["detail"]
    humanoid.post("/stop", {"reason": "a break"})
    assert humanoid.post("/sessions", asked, 409)["title"] == "Stopped"
    humanoid.post("/reset")
    assert humanoid.http.get("/sessions/none/report").status_code == 404
    assert humanoid.post("/sessions/none/end", status=404)["title"] == "No such session"


@pytest.mark.nightly
def test_a_patient_catches_what_the_robot_throws_and_the_report_says_so(humanoid: HumanoidCell) -> None:
    humanoid.start()
    asked = {
        "application": "juggling",
        "person": "aino",
        "goal": {"catches": 2},  # a pose that is late on a slow machine may miss
        "target": [0.8, 0.0, 0.6],
        "hand": "right",
    }
    session = humanoid.post("/sessions", asked, 201)["id"]
    with catching_patient(humanoid):
        wait_for(lambda: has_ball(humanoid, "held"), 4 * WITHIN_S, "the robot swings")
        humanoid.post(f"/sessions/{session}/pause")  # the hand keeps this ball, and the session its count
        wait_for(lambda: has_ended(humanoid, session), 4 * WITHIN_S, "both catches")
    report = humanoid.http.get(f"/sessions/{session}/report").json()
    results = [outcome["result"] for outcome in report["outcomes"]]
    assert (results.count("caught"), results[-1]) == (2, "caught")
    assert (report["throws"], report["caught"]) == (len(results), 2)
    assert report["shareCaught"] == 2 / len(results)
    (week,) = humanoid.http.get("/persons/aino/progress").json()
    assert (week["sessions"], week["caught"]) == (1, 2)
    wait_for(lambda: humanoid.state()["behaviour"] == "standing", WITHIN_S, "it stands again")
    assert humanoid.http.delete("/persons/aino").json() == {"sessions": 1}
    assert humanoid.http.get(f"/sessions/{session}").status_code == 404


@pytest.mark.nightly
def test_a_place_out_of_reach_is_refused_with_the_farthest_that_is_not(humanoid: HumanoidCell) -> None:
    humanoid.start()
    far = {"target": [2.5, 0.0, 0.5], "hand": "right"}
    assert humanoid.post("/throws", far, 409)["title"] == "Not juggling"
    humanoid.post("/behaviour", {"behaviour": "juggling"})
    wait_for(lambda: humanoid.state()["behaviour"] == "juggling", WITHIN_S, "it juggles")
    assert "the farthest place on that line is" in humanoid.post("/throws", far, 422)["detail"]

    thrown_s = float("-inf")

    def has_landed() -> bool:  # a hand keeps the ball when wishes are late on a slow machine: throw again
        nonlocal thrown_s
        state = humanoid.state()
        if (state["ball"] or {}).get("phase") == "landed":
            return True
        if state["t"] is not None and state["t"] - thrown_s > THROW_S:
            thrown_s = state["t"]
            humanoid.post("/throws", {"target": [0.8, 0.1, 0.5], "hand": "left"})
        return False

    wait_for(has_landed, WITHIN_S, "a throw lands")
    x, y, _ = humanoid.state()["ball"]["landing"]
    assert 0.4 < (x**2 + y**2) ** 0.5 < 1.2
    humanoid.post("/behaviour", {"behaviour": "walking"})


def has_ball(humanoid: HumanoidCell, phase: str) -> bool:
    """Return whether the ball is in a phase, or was: the session resumes what a slow machine pauses."""
    resume(humanoid)
    return bool((humanoid.state()["ball"] or {}).get("phase") == phase)


def has_ended(humanoid: HumanoidCell, session: str) -> bool:
    """Return whether a session has reached its goal; on a slow machine it pauses for silence meanwhile."""
    view: dict[str, Any] = humanoid.http.get(f"/sessions/{session}").json()
    if (view["live"] or {}).get("state") == "paused":
        humanoid.http.post(f"/sessions/{session}/resume")
    return bool(view["endedBy"] == "goal")
