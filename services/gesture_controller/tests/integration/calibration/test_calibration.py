"""Calibration with the real controller: guided by the hand's own frames, chosen, kept through `kill -9`."""

from collections.abc import Callable, Sequence
from typing import Any

import orjson
import pytest
from sqlalchemy import text

from glove_sdk_bridge.simulation.hand import AT_REST, FIST, OPEN_HAND, Posture, SimulatedHand
from handover.database import connect
from handover_gloves.calibration.drift_persistence import MIN_SAVED_CHANGE
from tests.kit.databases import default_url
from tests.kit.waiting import until

POINT: Posture = (0.0, 1.0, 0.0, 0.0, 0.0)
LEVELS = {"fist": [[300.0] * 5] * 50, "open": [[700.0] * 5] * 50}
"""Frames of a calibration in which every finger spans 300 to 700."""
APPLIED = {"applied": True, "problem": None, "sensorWarnings": []}


class SimulatedWearer:
    """A simulated hand in a TCP glove; its clock runs as fast as frames are sent."""

    def __init__(self, glove: Any) -> None:
        self.glove = glove
        self.hand = SimulatedHand(5, posture=AT_REST)

    def show(self, posture: Posture, seconds: float) -> None:
        """Move to `posture` and keep it."""
        self.hand.move(posture, 0.3)
        self.send([self.hand.read() for _ in range(round(seconds * 50))])

    def send(self, frames: Sequence[Sequence[float]]) -> None:
        """Send frames at 50 Hz of the glove's own clock."""
        lines = []
        for bend in frames:
            self.glove.t_s = round(self.glove.t_s + 0.02, 3)
            lines.append(
                orjson.dumps({"type": "frame", "t": self.glove.t_s, "bend": [float(one) for one in bend]})
            )
        self.glove.link.sendall(b"\n".join(lines) + b"\n")


@pytest.fixture
def wearer(put_on: Callable[..., Any], bench: Any) -> SimulatedWearer:
    """A person who has put on glove-1."""
    worn = SimulatedWearer(put_on())
    worn.show(AT_REST, 0.2)
    return worn


def calibrate(bench: Any, frames: dict[str, Any]) -> None:
    bench.screen.post("/gloves/glove-1/calibration", json=frames).raise_for_status()


def guide(bench: Any, **new: Any) -> dict[str, Any]:
    answer = bench.screen.post("/gloves/glove-1/calibration/guide", json=new)
    assert answer.status_code == 201, answer.text
    begun: dict[str, Any] = answer.json()
    return begun


def outcome(bench: Any) -> dict[str, Any] | None:
    outcome: dict[str, Any] | None = bench.view()["calibration"]["outcome"]
    return outcome


@pytest.mark.nightly
async def test_a_hand_is_guided_and_read_by_what_it_showed_after_a_crash_too(
    bench: Any,
    wearer: SimulatedWearer,
    put_on: Callable[..., Any],
    running_cell: Any,
    eventually: Callable[..., None],
) -> None:
    begun = guide(bench)
    assert begun["message"]["key"] == "calibration.fist.soon"
    assert bench.view()["testing"], "nothing that is shown meanwhile answers a Task"
    wearer.show(FIST, 4.5)
    eventually(lambda: bench.view()["calibration"]["step"] == "open")
    wearer.show(OPEN_HAND, 5)
    eventually(lambda: outcome(bench) is not None)
    assert outcome(bench) == APPLIED
    view = bench.view()
    assert not view["testing"]
    assert 480 < view["thresholds"]["index"]["lower"] < view["thresholds"]["index"]["upper"] < 720
    chosen = bench.screen.put("/gloves/glove-1/recognizer", json={"name": "personal"})
    assert chosen.json()["missing"] is None

    running_cell.restart("gesture_controller")
    again = SimulatedWearer(put_on())
    again.show(POINT, 1.5)
    eventually(lambda: bench.view()["gesture"] == "Point with index")
    assert bench.view()["recognizer"] == {"name": "personal", "missing": None}
    recognition = bench.screen.get("/gloves/glove-1/recognition").json()
    assert recognition["odds"]["Point with index"] > 0.9
    assert "index" in recognition["why"]


@pytest.mark.nightly
async def test_a_drift_that_was_followed_outlives_a_crash_and_ends_with_the_next_calibration(
    bench: Any,
    wearer: SimulatedWearer,
    put_on: Callable[..., Any],
    running_cell: Any,
    eventually: Callable[..., None],
) -> None:
    calibrate(bench, LEVELS)
    wearer.send([[300.0, 636, 636, 300, 300]] * 4000)  # 84 % of the span, where it should be 92 %
    eventually(lambda: bench.view()["frames"] > 4000)
    followed = bench.view()["drift"]
    assert followed["index"] < -20
    file = running_cell.data_dir / "gesture_controller.db"
    database = default_url(running_cell.data_dir) or f"sqlite:///{file}"
    followed_to = pytest.approx(list(followed.values()), abs=MIN_SAVED_CHANGE * 400)
    eventually(lambda: kept_drift(database) == followed_to)
    kept = kept_drift(database)

    running_cell.restart("gesture_controller")
    assert list(bench.view()["drift"].values()) == pytest.approx(kept, abs=0.01)
    again = SimulatedWearer(put_on())
    again.send([[300.0, 636, 636, 300, 300]] * 10)
    eventually(lambda: bench.view()["gesture"] == "Index and middle straight")
    calibrate(bench, LEVELS)
    running_cell.restart("gesture_controller")
    assert set(bench.view()["drift"].values()) == {0.0}, "it belonged to the calibration before"


async def test_an_interrupted_calibration_is_reported_until_the_next_one_begins(
    bench: Any,
    wearer: SimulatedWearer,
    put_on: Callable[..., Any],
    running_cell: Any,
    eventually: Callable[..., None],
) -> None:
    thresholds = bench.view()["thresholds"]
    guide(bench)
    wearer.show(FIST, 4.5)
    eventually(lambda: bench.view()["calibration"]["step"] == "open")
    running_cell.restart("gesture_controller")
    view = bench.view()
    assert view["calibration"]["phase"] == "interrupted"
    assert "nothing was changed, begin again" in view["calibration"]["outcome"]["problem"]
    assert not view["testing"], "Tasks are answered again"
    assert view["thresholds"] == thresholds
    again = SimulatedWearer(put_on())
    again.show(AT_REST, 0.2)
    guide(bench, countdownMs=0)
    again.show(FIST, 2)
    again.show(OPEN_HAND, 3)
    eventually(lambda: outcome(bench) == APPLIED)
    running_cell.restart("gesture_controller")
    assert bench.view()["calibration"] is None


def kept_drift(database: str) -> list[float] | None:
    """Return the stored drift of glove-1."""
    engine = connect(database, is_own=False)
    with engine.begin() as connection:
        offsets = connection.scalar(text("SELECT offsets FROM controller_drifts WHERE glove = 'glove-1'"))
    engine.dispose()
    return orjson.loads(offsets) if isinstance(offsets, str | bytes) else offsets


async def test_what_is_offered_counts_once_it_is_accepted(
    bench: Any, wearer: SimulatedWearer, eventually: Callable[..., None]
) -> None:
    before = bench.view()["thresholds"]
    guide(bench, apply=False, countdownMs=200)
    wearer.show(FIST, 2)
    wearer.show(OPEN_HAND, 3)
    eventually(lambda: outcome(bench) is not None)
    assert outcome(bench)["offered"]["levels"]["index"]["open"] > 600
    assert bench.view()["thresholds"] == before
    accepted = bench.screen.post("/gloves/glove-1/calibration/accept").json()
    assert accepted["thresholds"] != before
    assert not accepted["offered"]
    assert bench.screen.post("/gloves/glove-1/calibration/accept").status_code == 409
    restored = bench.screen.post("/gloves/glove-1/thresholds/restore").json()
    assert restored["thresholds"] == before


async def test_a_sample_is_shown_and_forgotten(
    bench: Any, wearer: SimulatedWearer, eventually: Callable[..., None]
) -> None:
    refused = bench.screen.post("/gloves/glove-1/calibration/guide", json={"gesture": "Horns"})
    assert refused.status_code == 409
    assert "calibrate it with them first" in refused.json()["detail"]
    hand = SimulatedHand(9, posture=FIST)
    fist = [hand.read() for _ in range(50)]
    hand = SimulatedHand(9, posture=OPEN_HAND)
    open_hand = [hand.read() for _ in range(50)]
    calibrate(bench, {"fist": fist, "open": open_hand})
    guide(bench, gesture="point with index", countdownMs=0)
    wearer.show(POINT, 3)
    eventually(lambda: outcome(bench) is not None)
    assert outcome(bench)["applied"]
    samples = bench.screen.get("/gloves/glove-1/calibration").json()["samples"]
    assert samples["20222"]["shares"][1] > 0.8
    assert bench.screen.delete("/gloves/glove-1/samples/Point with index").status_code == 204
    assert bench.screen.delete("/gloves/glove-1/samples/20222").status_code == 404
    assert bench.screen.get("/gloves/glove-1/calibration").json()["samples"] == {}


async def test_a_level_that_jumps_raises_an_alert_until_the_next_calibration(
    bench: Any, wearer: SimulatedWearer, eventually: Callable[..., None]
) -> None:
    calibrate(bench, LEVELS)
    wearer.send(LEVELS["open"])
    wearer.send([[700.0, 700, 700, 860, 700]] * 100)
    eventually(lambda: bench.view()["calibrationNeeded"])
    assert "ring jumped" in bench.view()["calibrationNeeded"]

    async def is_raised() -> bool:
        alerts = [one for one in await bench.alerts() if one["subCategory"]["value"] == "calibrationNeeded"]
        return any("validTo" not in one for one in alerts)

    async def is_cleared() -> bool:
        return not await is_raised()

    await until(is_raised)
    calibrate(bench, LEVELS)
    assert bench.view()["calibrationNeeded"] is None
    await until(is_cleared)
