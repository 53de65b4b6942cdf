"""`python -m glove_sdk_bridge` as a person, or a vendor's program, starts it."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from glove_sdk_bridge.__main__ import main
from glove_sdk_bridge.frames import Frame, Hello
from glove_sdk_bridge.recording import RecordingWriter
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import scaled

Bridge = Callable[..., subprocess.Popen[bytes]]


def environment(**more: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}
    return {**kept, "PYTHONPATH": str(REPOSITORY), **more}


def test_frames_are_forwarded_with_the_standard_library_alone(
    bridge: Bridge, desk: Any, eventually: Any
) -> None:
    process = bridge(
        "forward", "--port", str(desk.port), "--glove", "vendor-7", "--hand", "left", python=("-S",)
    )
    said, complaints = process.communicate(b'1,2,3,4,5\n{"bend":[6,7,8,9,10]}\ngarbage\n', timeout=120)
    assert process.returncode == 0, complaints
    assert not said
    eventually(lambda: len(desk.frames) == 2)
    assert desk.visits[0].hello == Hello("vendor-7", "left")
    assert [frame.bend for frame in desk.frames] == [(1, 2, 3, 4, 5), (6, 7, 8, 9, 10)]
    assert b"2 frames sent, 0 dropped; 1 lines were no frames" in complaints
    assert b"a line is dropped" in complaints


def test_nothing_but_the_standard_library_is_imported() -> None:
    program = (
        "import sys, runpy; before = set(sys.modules)\n"
        "sys.argv = ['glove', '--help']\n"
        "try: runpy.run_module('glove_sdk_bridge', run_name='__main__')\n"
        "except SystemExit: pass\n"
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before})"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program],
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    ).stdout
    imported = set(printed.splitlines()[-1].split())
    assert "glove_sdk_bridge" in imported
    assert not imported - {"glove_sdk_bridge", *sys.stdlib_module_names}


def test_the_token_comes_from_the_environment(bridge: Bridge, desk: Any, eventually: Any) -> None:
    process = bridge("forward", "--port", str(desk.port), HANDOVER_GLOVE_TOKEN="s3cret")
    process.communicate(b"1,2,3,4,5\n", timeout=120)
    assert desk.visits[0].hello.token == "s3cret"


def test_a_wrong_token_is_one_line_and_exit_code_2_even_while_the_input_is_open(
    bridge: Bridge, desk: Any
) -> None:
    desk.answer = b'{"type":"error","reason":"the token is wrong; give the glove the HANDOVER_GLOVE_TOKEN"}\n'
    process = bridge("forward", "--port", str(desk.port), "--token", "gue55")
    assert process.wait(timeout=120) == 2
    assert process.stderr is not None
    complaint = process.stderr.read().decode()
    refusal = "the token is wrong; give the glove the HANDOVER_GLOVE_TOKEN"
    assert complaint.splitlines() == [f"glove: 127.0.0.1:{desk.port} refuses glove-1: {refusal}"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no such signals to one process")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_end_it_quietly(
    bridge: Bridge, desk: Any, eventually: Any, tmp_path: Path, number: int
) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("pose,thumb,index,middle,ring,little\n0,1,2,3,4,5\n")
    process = bridge("replay", str(file), "--loop", "--port", str(desk.port))
    eventually(lambda: len(desk.frames) > 3)
    process.send_signal(number)
    _, complaints = process.communicate(timeout=scaled(120))
    assert process.returncode == 0
    assert b"Traceback" not in complaints


def test_a_part_of_something_larger_ends_with_it(
    bridge: Bridge, desk: Any, eventually: Any, tmp_path: Path
) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("pose,thumb,index,middle,ring,little\n0,1,2,3,4,5\n")
    process = bridge("replay", str(file), "--loop", "--port", str(desk.port), HANDOVER_LIFELINE="1")
    eventually(lambda: desk.frames)
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(timeout=120) == 0


def test_a_recording_is_replayed_to_the_last_frame_with_its_hand(
    desk: Any, eventually: Any, tmp_path: Path
) -> None:
    file = tmp_path / "hand.jsonl"
    with RecordingWriter(file, Hello("glove-9", "left")) as recording:
        for place in range(40):
            recording.write(Frame(place / 100, (place, 2, 3, 4, 5)))
    assert main(["replay", str(file), "--port", str(desk.port), "--speed", "4"]) == 0
    eventually(lambda: len(desk.frames) == 40)
    assert desk.visits[0].hello == Hello("glove-1", "left")
    assert [frame.bend[0] for frame in desk.frames] == list(range(40))
    assert desk.frames[-1].t_s - desk.frames[0].t_s == pytest.approx(0.39, abs=1e-5)


def test_a_replay_waits_for_the_controller_rather_than_play_to_nobody(
    bridge: Bridge, closed_desk: Any, eventually: Any, tmp_path: Path
) -> None:
    file = tmp_path / "hands.csv"
    file.write_text("pose,thumb,index,middle,ring,little\n" + "0,1,2,3,4,5\n" * 5)
    process = bridge("replay", str(file), "--port", str(closed_desk.port))
    assert process.stderr is not None
    assert b"trying again until it does" in process.stderr.readline()
    closed_desk.open()
    _, complaints = process.communicate(timeout=scaled(120))
    assert process.returncode == 0
    assert b"5 frames sent, 0 dropped" in complaints
    assert len(closed_desk.frames) == 5


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["dance"], "invalid choice: 'dance'"),
        (["replay"], "the following arguments are required: file"),
        (["replay", "gone.csv"], "gone.csv cannot be read"),
        (["replay", "gone.csv", "--speed", "0"], "'0' is not a number from 0.001"),
        (["replay", "gone.csv", "--speed", "nan"], "'nan' is not a number from 0.001"),
        (["replay", "gone.csv", "--pose", "1,,2"], "'1,,2' is no list of poses"),
        (["forward", "--port", "70000"], "'70000' is not a port"),
        (["forward", "--glove", "my glove"], "a glove is named by"),
        (["forward", "--hand", "middle"], "invalid choice: 'middle'"),
        (["simulate", "--mistakes", "2"], "'2' is not a share from 0 to 1"),
        (["simulate", "--rate", "1"], "'1' is not a rate"),
        (["simulate", "--controller", "127.0.0.1:54210"], "127.0.0.1:54210 is no URL of a controller"),
        (["serial", "/nowhere/ttyUSB0"], "/nowhere/ttyUSB0 cannot be opened"),
        (["record", "hand.jsonl", "--controller", "ftp://x"], "ftp://x is no URL of a controller"),
        (["record", "hand.jsonl", "--controller", "http://127.0.0.1:1"], "does not answer"),
    ],
)
def test_what_a_person_mistypes_is_answered_in_one_line_and_exit_code_2(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert complaint in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["--help"], ["replay", "--help"], ["simulate", "--help"]])
def test_help_is_no_error(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words, program="handover glove") == 0
    assert "handover glove" in capsys.readouterr().out


@pytest.mark.nightly
@pytest.mark.slow
def test_frames_that_nobody_takes_are_said_and_exit_code_2(bridge: Bridge, closed_desk: Any) -> None:
    process = bridge("forward", "--port", str(closed_desk.port))
    _, complaints = process.communicate(b"1,2,3,4,5\n", timeout=120)
    assert process.returncode == 2
    assert b"none of the 1 frames could be sent" in complaints
