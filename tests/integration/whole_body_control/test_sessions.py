"""Sessions of persons: what is kept of them, and what ends, pauses and deletes them."""

from tests.integration.whole_body_control.conftest import HumanoidCell


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
