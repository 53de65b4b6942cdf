"""Recorded frames, replayed over TCP, complete the Tasks of a real process."""

import itertools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.kit.waiting import scaled

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

GESTURE_OF_POSE = {
    "1": "Point with index",
    "2": "Index and middle straight",
    "3": "Middle, ring and little straight",
    "6": "Thumb and little straight",
    "8": "Thumb and index straight",
}
ONE_SECOND = 50


def five_confirmations() -> str:
    """A process of one person who confirms five times, each time with another gesture."""
    steps = [
        f'<userTask id="pose_{pose}" name="Show {gesture}"><extensionElements>'
        f'<handover:task definition="show-{pose}"><handover:involves resource="Device:glove-1"/>'
        f'<handover:parameter name="commandId" value="{pose}"/>'
        f'<handover:parameter name="gesture" value="{gesture}"/></handover:task>'
        f"</extensionElements></userTask>"
        for pose, gesture in GESTURE_OF_POSE.items()
    ]
    nodes = ["begin", *(f"pose_{pose}" for pose in GESTURE_OF_POSE), "end"]
    flows = [
        f'<sequenceFlow id="flow_{here}" sourceRef="{here}" targetRef="{there}"/>'
        for here, there in itertools.pairwise(nodes)
    ]
    return (
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" '
        'xmlns:handover="urn:handover:bpmn" targetNamespace="urn:test">'
        '<process id="five-confirmations" isExecutable="true"><startEvent id="begin"/>'
        f'{"".join(steps)}<endEvent id="end"/>{"".join(flows)}</process></definitions>'
    )


def glove_command(cell: Any, *words: str) -> subprocess.Popen[bytes]:
    """`handover glove …`, as a person would type it."""
    command = [sys.executable, "-m", "handover_cell", "glove", *words, "--glove", "glove-1"]
    return subprocess.Popen(command, env=cell.environment, cwd=cell.data_dir, stderr=subprocess.PIPE)


def test_five_recorded_gestures_complete_five_tasks(
    cell: Any, recordings: Path, eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "task_orchestrator", "gesture_controller")
    orchestrator, glove = cell.url("task_orchestrator"), f"{cell.url('gesture_controller')}/gloves/glove-1"
    file = recordings / "person_b.csv"

    _, said = glove_command(cell, "calibrate", "--from", str(file)).communicate(timeout=scaled(120))
    assert b"glove-1 is calibrated" in said, said
    deployed = httpx.post(
        f"{orchestrator}/definitions",
        content=five_confirmations(),
        headers={"Content-Type": "application/xml"},
        timeout=120,
    )
    assert deployed.status_code == 201, deployed.text
    process = httpx.post(
        f"{orchestrator}/processes", json={"definition": "five-confirmations"}, timeout=120
    ).json()["id"]

    def asked() -> str | None:
        task = httpx.get(glove, timeout=120).json()["task"]
        return task and task["gesture"]

    def frames() -> int:
        return int(httpx.get(glove, timeout=120).json()["frames"])

    poses = list(GESTURE_OF_POSE)
    for pose, wrong in zip(poses, poses[1:] + poses[:1], strict=True):
        eventually(lambda pose=pose: asked() == GESTURE_OF_POSE[pose])
        for shown in (wrong, pose):
            before, hand = frames(), glove_command(cell, "replay", str(file), "--pose", shown, "--loop")
            try:
                if shown == wrong:  # three seconds of it: twice what confirms
                    eventually(lambda before=before: frames() - before > 3 * ONE_SECOND)
                    assert asked() == GESTURE_OF_POSE[pose]
                else:
                    eventually(lambda pose=pose: asked() != GESTURE_OF_POSE[pose])
            finally:
                hand.terminate()
                hand.communicate(timeout=scaled(120))

    eventually(
        lambda: httpx.get(f"{orchestrator}/processes/{process}", timeout=120).json()["status"] == "completed"
    )
    tasks = httpx.get(
        f"{cell.url('context_broker')}/ngsi-ld/v1/entities",
        params={"type": "Task", "options": "keyValues"},
        timeout=120,
    ).json()
    ended = {task["workParameters"]["gesture"]: task for task in tasks}
    assert set(ended) == set(GESTURE_OF_POSE.values())
    for gesture, task in ended.items():
        assert task["outputParameters"]["gesture"] == gesture
        assert task["outputParameters"]["by"] == "gesture"
        assert task["outputParameters"]["heldMs"] >= 1500
