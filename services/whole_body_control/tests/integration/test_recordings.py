"""Recordings of the humanoid: MCAP files of the control cycle, complete also after a crash, and bounded."""

import base64
import hashlib
import io
from typing import Any

import pytest
from mcap.reader import make_reader

from services.whole_body_control.tests.integration.conftest import SERVICE, WITHIN_S, HumanoidCell
from tests.kit.waiting import wait_for


def _one(humanoid: HumanoidCell, recording: str) -> dict[str, Any]:
    recordings: list[dict[str, Any]] = humanoid.http.get("/recordings").json()
    return next(listed for listed in recordings if listed["id"] == recording)


def _start(humanoid: HumanoidCell, label: str = "") -> dict[str, Any]:
    made: dict[str, Any] = humanoid.post("/recordings", {"label": label}, 201)
    began = humanoid.state()["t"]
    wait_for(lambda: humanoid.state()["t"] > began + 1, WITHIN_S, "a second of the robot's time")
    return made


@pytest.mark.nightly
def test_what_the_cycle_did_is_recorded_downloaded_and_replayed(humanoid: HumanoidCell) -> None:
    humanoid.start()
    made = _start(humanoid, "stand")
    this = f"/recordings/{made['id']}"
    assert (made["state"], made["label"], made["sha256"]) == ("running", "stand", None)
    assert humanoid.post("/recordings", status=409)["title"] == "Already recording"
    assert humanoid.http.get(this).json()["title"] == "Still recording"
    ended = humanoid.post(f"{this}/stop")
    assert (ended["state"], ended["endReason"]) == ("ended", "stopped")
    assert humanoid.post(f"{this}/stop", status=409)["title"] == "Not recording"
    file = humanoid.http.get(this)
    digest = hashlib.sha256(file.content)
    assert (digest.hexdigest(), len(file.content)) == (ended["sha256"], ended["size"])
    assert file.headers["repr-digest"] == f"sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    reader = make_reader(io.BytesIO(file.content), validate_crcs=True)
    topics = [channel.topic for _, channel, _ in reader.iter_messages()]
    assert (set(topics), len(topics)) == ({"/state", "/wish", "/live"}, ended["messages"])

    replay = humanoid.http.get(f"{this}/frames").json()
    documents = [frame["document"] for frame in replay["frames"]]
    assert all(document["phase"] == "standing" and len(document["joints"]) == 29 for document in documents)
    times = [frame["t"] for frame in replay["frames"]]
    assert times == sorted(times)
    assert 0 <= times[0] <= times[-1] <= replay["durationS"]
    middle = replay["durationS"] / 2
    halves = [
        humanoid.http.get(f"{this}/frames", params=span).json()["frames"]
        for span in ({"to": middle}, {"from": middle})
    ]
    assert [len(half) > 0 for half in halves] == [True, True]
    assert halves[0] + halves[1] == replay["frames"]
    for span in ({"from": "nan"}, {"from": 2, "to": 1}):
        assert humanoid.http.get(f"{this}/frames", params=span).status_code == 422
    assert humanoid.http.get(f"{this}/frames", params={"from": 1e6}).json()["frames"] == []
    assert humanoid.http.delete(this).status_code == 204
    assert humanoid.http.get(f"{this}/frames").json()["title"] == "No such recording"


@pytest.mark.nightly
def test_a_recording_is_complete_after_the_service_was_killed_and_old_ones_make_room(
    humanoid: HumanoidCell,
) -> None:
    humanoid.start()
    made = _start(humanoid)
    folder = humanoid.cell.data_dir / "humanoid-recordings"
    path = folder / f"{made['id']}.mcap"
    wait_for(lambda: path.stat().st_size > 1000, WITHIN_S, "a chunk is on the disk")
    humanoid.cell.kill(SERVICE)
    (folder / "R-0123456789abcdef.mcap").touch()  # its deletion was interrupted
    humanoid.start()
    listed = _one(humanoid, made["id"])
    assert (listed["state"], listed["endReason"]) == ("ended", "interrupted")
    assert listed["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert humanoid.http.get(f"/recordings/{made['id']}/frames").json()["frames"]
    assert [file.name for file in folder.iterdir()] == [path.name]
    humanoid.cell.extra["HANDOVER_HUMANOID_RECORDING_MINUTES"] = "0.01"
    humanoid.cell.extra["HANDOVER_HUMANOID_RECORDING_DAYS"] = "0.000001"
    humanoid.cell.restart(SERVICE)
    humanoid.start()
    del humanoid.cell.extra["HANDOVER_HUMANOID_RECORDING_MINUTES"]
    del humanoid.cell.extra["HANDOVER_HUMANOID_RECORDING_DAYS"]
    wait_for(lambda: humanoid.http.get("/recordings").json() == [], WITHIN_S, "the old one is deleted")
    short = humanoid.post("/recordings", status=201)
    wait_for(lambda: _one(humanoid, short["id"])["endReason"] == "tooLong", WITHIN_S, "the bound is reached")
