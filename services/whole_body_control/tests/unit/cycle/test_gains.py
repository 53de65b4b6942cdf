"""People change the gains of joints by chain: within limits, without a jump, and the robot still walks."""

from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem, UsageError
from handover_humanoid.control_process import control_loop
from handover_humanoid.cycle.deployment import Deployment
from handover_humanoid.cycle.gains import CHANGE_S, GainTransition, gain_fields
from handover_humanoid.cycle.loop import Mode
from handover_humanoid.cycle.ports import PortWriter
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.model.reading import read_folder
from handover_humanoid.robots import COMAN as FOLDER
from handover_humanoid.robots import humanoid
from handover_humanoid.running.gains import OF_THE_MODEL, ChainGains, Shares

COMAN = humanoid("coman")
FIELDS = gain_fields(COMAN)
PERIOD_S = 0.01
COMPONENTS = {
    "robot": {"kind": "mujoco", "realtime": True},
    "walking": {"kind": "walking", "realtime": True},
}
any_share = st.floats(-10, 10)


@given(st.lists(any_share, min_size=len(FIELDS), max_size=len(FIELDS)))
def test_shares_move_gradually_to_the_wanted_ones_and_never_beyond_the_limits(wanted: list[float]) -> None:
    shares = GainTransition(COMAN)
    shares.want(np.array(wanted))
    for _ in range(round(CHANGE_S / PERIOD_S)):
        before = shares.values.copy()
        shares.step(PERIOD_S)
        assert np.abs(shares.values - before).max() <= PERIOD_S / CHANGE_S + 1e-12
    for index, (chain, limits) in enumerate(COMAN.gain_limits.items()):
        stiffness, damping = shares.values[2 * index : 2 * index + 2]
        assert stiffness == pytest.approx(np.clip(wanted[2 * index], *limits.stiffness))
        assert damping == pytest.approx(np.clip(wanted[2 * index + 1], *limits.damping))
        assert set(shares.stiffness[list(COMAN.tunable[chain])]) == {stiffness}


def test_the_cycle_walks_at_lopsided_limits_and_keeps_them_when_their_writer_has_ended(
    tmp_path: Path,
) -> None:
    deployment = Deployment.model_validate(
        {"folder": tmp_path, "paced": False, "fifo": False, "components": COMPONENTS}
    )
    loop, state = control_loop(deployment)
    wish, gains = PortWriter(tmp_path / "wish", WISH), PortWriter(tmp_path / "gains", FIELDS)

    def run(seconds: float, ahead_mps: float) -> None:
        wanted = {"speed_share": 1.0, "ahead_mps": ahead_mps}
        values = np.array([wanted.get(name, 0.0) for name in WISH])
        for _ in range(round(seconds / loop.robot.period_s)):
            wish.write(values)
            loop.cycle()
        assert state.read()

    def shown() -> dict[str, float]:
        return {name: state.value(f"gain.{name}") for name in FIELDS}

    run(0.2, 0.0)
    assert set(shown().values()) == {1.0}
    wanted = dict.fromkeys(FIELDS, 1.0)
    for side, share in (("left", 0), ("right", 1)):
        limits = COMAN.gain_limits[f"{side}_leg"]
        wanted |= {
            f"{side}_leg.stiffness": limits.stiffness[share],
            f"{side}_leg.damping": limits.damping[1 - share],
        }
    gains.write(np.array(list(wanted.values())))
    gains.close()
    run(0.1, 0.0)
    assert 1.0 < shown()["right_leg.stiffness"] < wanted["right_leg.stiffness"]
    run(6.0, 0.12)
    assert shown() == pytest.approx(wanted)
    assert (loop.mode, loop.fault) == (Mode.FOLLOWING, "")
    assert state.value("com.x") > 0.3
    with_nan = PortWriter(tmp_path / "gains", FIELDS)
    with_nan.write(np.full(len(FIELDS), np.nan))
    run(0.5, 0.0)
    assert shown() == pytest.approx(wanted)


def test_a_share_beyond_the_limits_is_refused_with_the_chain_and_the_limits() -> None:
    gains = ChainGains(COMAN)
    with pytest.raises(Problem, match=r'stiffness of "left_arm" must be 70 to 150 %.*not 300 %'):
        gains.changed({"right_arm": OF_THE_MODEL, "left_arm": Shares(3.0, 1.0)})
    with pytest.raises(Problem, match=r'damping of "torso" must be .*not 10 %'):
        gains.changed({"torso": Shares(1.0, 0.1)})
    with pytest.raises(Problem, match=r'"tail" cannot be changed; the model permits: left_arm, '):
        gains.changed({"tail": OF_THE_MODEL})
    assert gains.by_chain == gains.defaults()


def test_stored_gains_that_the_model_permits_no_more_are_left_out() -> None:
    gains = ChainGains(COMAN)
    kept = {"left_leg": Shares(1.2, 0.9), "right_arm": Shares(0.8, 1.0)}
    gains.restore({**kept, "tail": Shares(1.1, 1.0), "torso": Shares(9.0, 1.0)})
    assert gains.by_chain == {**gains.defaults(), **kept}


def test_a_model_without_limits_of_gains_lets_nobody_change_them_and_wrong_limits_are_faults(
    tmp_path: Path,
) -> None:
    folder = Path(copytree(FOLDER, tmp_path / "coman"))
    text = (folder / "robot.yaml").read_text()
    start = text.index("gain_limits:")
    end = text.index("modes:")
    (folder / "robot.yaml").write_text(text[:start] + text[end:])
    fixed = read_folder(folder)
    assert (fixed.gain_limits, gain_fields(fixed)) == ({}, ())
    GainTransition(fixed).step(PERIOD_S)
    with pytest.raises(Problem, match="the model permits: -"):
        ChainGains(fixed).changed({"left_arm": OF_THE_MODEL})
    wrong = (
        "gain_limits:\n  tail: {stiffness: [0.5, 2], damping: [0.5, 2]}\n"
        "  left_arm: {stiffness: [1.2, 2], damping: [0.5, 2]}\n"
    )
    (folder / "robot.yaml").write_text(text[:start] + wrong + text[end:])
    with pytest.raises(UsageError, match='gain_limits for "tail", which is no chain') as refused:
        read_folder(folder)
    assert 'the stiffness of "left_arm" to 1.2 … 2' in str(refused.value)
