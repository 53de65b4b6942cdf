"""The service of a humanoid: it starts the control cycle, shows its state, and either may be killed."""

import os
import signal
from typing import Any

import orjson
import pytest
from websockets.sync.client import connect

from handover_humanoid.cycle.ports import PortReader
from services.whole_body_control.tests.integration.conftest import SERVICE, WITHIN_S, HumanoidCell
from services.whole_body_control.tests.integration.people import socket_url, stands, therapist_at
from tests.kit.waiting import wait_for


@pytest.mark.nightly
def test_the_model_is_shown_by_chains_and_drawn_by_its_urdf(humanoid: HumanoidCell) -> None:
    models = humanoid.http.get("/humanoids").json()
    model = next(described for described in models if described["model"] == "coman")
    assert all(described["problem"] or described["joints"] > 20 for described in models)
    assert (model["model"], model["name"], model["drivers"]) == ("coman", "coman-1", ["simulated"])
    shown = humanoid.http.get("/model").json()
    arm = next(chain for chain in shown["chains"] if chain["name"] == "right_arm")
    assert len(arm["joints"]) == 7
    assert all(joint["lower"] < joint["upper"] and joint["gain"] > 0 for joint in arm["joints"])
    assert "<robot" in humanoid.http.get("/model/urdf").text
    assert len(humanoid.state()["joints"]) == len(shown["joints"]) == 29


def test_the_live_state_follows_the_clock_of_the_robot(humanoid: HumanoidCell) -> None:
    with connect(socket_url(humanoid, "/live"), proxy=None) as socket:
        documents = [orjson.loads(socket.recv(timeout=WITHIN_S)) for _ in range(5)]
    assert [document["phase"] for document in documents] == ["standing"] * 5
    assert documents[-1]["t"] > documents[0]["t"]
    assert documents[0]["base"][2] > 0.4
    shares = [documents[0]["feet"][side]["share"] for side in ("left", "right")]
    assert abs(sum(shares) - 1) < 0.05


@pytest.mark.nightly
def test_a_stop_stays_until_a_person_resets_it_also_over_a_restart_of_the_service(
    humanoid: HumanoidCell,
) -> None:
    process = humanoid.cycle()["pid"]
    humanoid.post("/stop", {"reason": "the patient is tired"})
    humanoid.cell.restart(SERVICE)
    humanoid.start()
    stop = humanoid.state()["stop"]
    assert stop["isStopped"]
    assert stop["reason"] == "the patient is tired"
    assert humanoid.post("/throws", {"target": [0.8, 0, 0.5]}, 409)["title"] == "Stopped"
    assert humanoid.cycle()["pid"] == process  # the killed service has not disturbed the cycle
    assert not humanoid.post("/reset")["isStopped"]


@pytest.mark.nightly
def test_gains_of_chains_are_changed_within_their_limits_stored_and_reset(humanoid: HumanoidCell) -> None:
    humanoid.start()

    def chain(name: str) -> dict[str, Any]:
        gains: list[dict[str, Any]] = humanoid.http.get("/gains").json()
        return next(of_chain for of_chain in gains if of_chain["chain"] == name)

    def applied() -> tuple[float, float]:
        shares = humanoid.state()["gains"]["left_arm"]
        return shares["stiffness"], shares["damping"]

    assert (chain("left_arm")["stiffness"], applied()) == (1.0, (1.0, 1.0))
    most = chain("left_arm")["stiffnessLimits"][1]
    wanted = {"chains": {"left_arm": {"stiffness": most, "damping": 0.8}}}
    answer = humanoid.http.put("/gains", json=wanted)
    assert answer.status_code == 200, answer.text
    wait_for(lambda: applied() == (most, 0.8), WITHIN_S, "the joints have the gains")
    refused = humanoid.http.put("/gains", json={"chains": {"left_arm": {"stiffness": 9}}})
    assert (refused.status_code, refused.json()["title"]) == (422, "Out of limits")
    assert 'stiffness of "left_arm" must be' in refused.json()["detail"]
    for wrong in (
        {"left_arm": {"stiffness": "soft"}},
        {"left_arm": {"mass": 1}},
        {"left_arm": {"damping": -1}},
    ):
        assert humanoid.http.put("/gains", json={"chains": wrong}).status_code == 422
    humanoid.cell.restart(SERVICE)
    humanoid.start()
    assert chain("left_arm")["stiffness"] == most
    wait_for(lambda: applied() == (most, 0.8), WITHIN_S, "the joints have the gains")
    actions = [record["action"] for record in humanoid.http.get("/audit").json()]
    assert any("gains" in action.lower() for action in actions), actions
    assert humanoid.http.delete("/gains").status_code == 200
    wait_for(lambda: applied() == (1.0, 1.0), WITHIN_S, "the gains of the model")
    assert chain("left_arm")["stiffness"] == 1.0


@pytest.mark.nightly
def test_the_end_of_the_control_cycle_is_reported_and_a_person_restarts_it(humanoid: HumanoidCell) -> None:
    humanoid.start()
    process = humanoid.cycle()["pid"]
    assert humanoid.post("/restart", status=409)["title"] == "Control cycle runs"
    os.kill(process, signal.SIGKILL)
    wait_for(
        lambda: (humanoid.state()["fault"] or {}).get("code") == "cycleEnded", WITHIN_S, "the end is reported"
    )
    assert "has ended" in humanoid.state()["fault"]["message"]
    assert not humanoid.cycle()["isRunning"]
    assert humanoid.post("/restart")["pid"] != process
    humanoid.start()
    wait_for(lambda: stands(humanoid), WITHIN_S, "it stands")


@pytest.mark.nightly
def test_a_therapist_walks_it_and_a_stop_or_a_killed_service_ends_that_on_both_feet(
    humanoid: HumanoidCell,
) -> None:
    humanoid.start()
    with therapist_at(humanoid) as therapist:
        therapist.hold({"ahead": 0.1}, until=lambda: humanoid.state()["phase"] == "single")
        humanoid.post("/stop", {"reason": "enough"})
        therapist.hold({"ahead": 0.1}, until=lambda: stands(humanoid), again=False)
        place = humanoid.state()["base"]
        humanoid.post("/reset")
        assert humanoid.state()["needsRelease"]  # what is still held does not move it again
        assert stands(humanoid)
        therapist.release()
        therapist.hold({"ahead": 0.1}, until=lambda: humanoid.state()["phase"] == "single")
        process, walked = humanoid.cycle()["pid"], humanoid.state()["base"][0]
        assert walked > place[0] - 0.05
        humanoid.cell.kill(SERVICE)
    port = PortReader(humanoid.folder / "state")
    wait_for(lambda: port.read() and port.value("phase") == 0, WITHIN_S, "the robot stands by itself")
    humanoid.start()
    state = humanoid.state()
    assert (humanoid.cycle()["pid"], state["base"][2] > 0.4, state["fault"]) == (process, True, None)


def test_inputs_that_are_invalid_or_of_another_role_are_refused_with_a_reason(humanoid: HumanoidCell) -> None:
    humanoid.start()
    with connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as socket:

        def answer(message: object) -> dict[str, object]:
            socket.send(orjson.dumps(message).decode())
            document: dict[str, object] = orjson.loads(socket.recv(timeout=WITHIN_S))
            return document

        assert answer({"kind": "pose", "t": 12.5, "tracking": "ok"}) == {"kind": "echo", "t": 12.5}
        assert "does not send" in str(answer({"kind": "wish", "held": True})["reason"])
        assert "held" in str(answer({"kind": "wish", "held": "true"})["reason"])
        hand = {"position": [1e400, 0, 0], "grip": 0}
        for wrong in ({"kind": "pose"}, {"kind": "pose", "t": 1, "hands": {"left": hand}}, [1]):
            assert answer(wrong)["kind"] == "error"
        with connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as other:
            answer({"kind": "pose", "t": 13.0})
            other.send(orjson.dumps({"kind": "pose", "t": 1}).decode())
            assert "another person" in orjson.loads(other.recv(timeout=WITHIN_S))["reason"]
