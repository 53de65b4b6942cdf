"""The study of the trainer on its own clock: heart rates from signals, a seed repeats it."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from handover.errors import UsageError
from handover_cases.machines.treadmill.belt import BeltState, StopReason
from handover_cases.machines.treadmill.training import Plan
from handover_cell.cases.treadmill import PARTICIPANTS, SEED, perform_study, walk
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import scaled


@pytest.mark.nightly
def test_a_walker_is_coached_on_a_heart_rate_from_signals_and_a_seed_repeats_it() -> None:
    said: list[str] = []
    first = walk(PARTICIPANTS[1], Plan(100.0), SEED, said.append)
    again = walk(PARTICIPANTS[1], Plan(31.0), SEED, said.append)
    assert list(again.record) == list(first.record)[: len(again.record)]
    assert again.decisions == first.decisions[:1]
    assert (first.belt.state, first.belt.reason) == (BeltState.STOPPED, StopReason.TIME)
    rates = [one.bpm for one in first.record if one.bpm is not None]
    assert len(rates) > 0.95 * len(first.record)
    assert rates[0] == pytest.approx(70, abs=5)
    assert max(rates) > 80, "the walk shows in the heart rate"
    assert len(said) == len(first.decisions) + 1 == 4
    figures = first.figures()
    assert figures.highest_mps <= 1.3
    assert figures.furthest_m < 0.5


def test_a_study_of_a_time_that_cannot_be_is_refused() -> None:
    with pytest.raises(UsageError, match="must be 30 to 3600"):
        perform_study(5.0, print)


COMPLETIONS = REPOSITORY / "services/assistive_devices/tests/unit/treadmill/completions.py"


@contextmanager
def model_server(kind: str) -> Iterator[tuple[str, Callable[[], list[dict[str, Any]]]]]:
    """Run a server of chat completions as a process; give its URL, and a function for what it was asked."""
    process = subprocess.Popen(
        [sys.executable, str(COMPLETIONS), kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None

    def asked() -> list[dict[str, Any]]:
        rest, _ = process.communicate()  # closes its input, so that it ends
        return [json.loads(line) for line in rest.splitlines()]

    try:
        yield process.stdout.readline().strip(), asked
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def study(url: str, *arguments: str, timeout_s: float = 30.0) -> str:
    """Run the study of a training of a minute, and return what it prints."""
    environment = {
        **os.environ,
        "HANDOVER_TRAINER_MODEL_URL": url,
        "HANDOVER_TRAINER_MODEL_NAME": "small-model",
        "HANDOVER_TRAINER_MODEL_KEY": "a-key",
        "HANDOVER_TRAINER_MODEL_TIMEOUT_S": str(min(20, timeout_s)),
    }
    command = [sys.executable, "-m", "handover_cell", "case", "treadmill", "--once", "--duration=59"]
    ended = subprocess.run(
        [*command, *arguments], env=environment, capture_output=True, text=True, timeout=scaled(120)
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def lines_of(text: str) -> list[str]:
    """Return what the trainer has said, without the time and the pulse before it."""
    return [line.split(" m/s: ")[1] for line in text.splitlines() if " m/s: " in line]


@pytest.mark.nightly
def test_the_command_lets_a_model_in_another_process_word_what_the_trainer_says() -> None:
    with model_server("obedient") as (url, asked):
        said = lines_of(study(url, "--consent-to-model"))
        requests = asked()
    assert len(said) == len(requests) == len(PARTICIPANTS)
    assert all(line.endswith("(model)") for line in said)
    for request in requests:
        assert request["path"] == "/v1/chat/completions"
        assert request["headers"]["Authorization"] == "Bearer a-key"
        assert request["body"].keys() == {"model", "messages", "max_tokens", "temperature"}
        text = " ".join(one["content"] for one in request["body"]["messages"])
        assert not any(letter.isdigit() for letter in text), "no heart rate, age, speed or time"
        for participant in PARTICIPANTS:
            assert participant.name not in text


@pytest.mark.nightly
def test_without_consent_the_command_asks_no_model() -> None:
    with model_server("obedient") as (url, asked):
        said = lines_of(study(url))
        assert asked() == []
    assert len(said) == len(PARTICIPANTS)
    assert not any("model" in line for line in said)


@pytest.mark.nightly
def test_nonsense_and_silence_of_a_model_leave_the_template() -> None:
    with model_server("nonsense") as (url, asked):
        said = lines_of(study(url, "--consent-to-model"))
        assert len(asked()) == len(said)
    assert not any("182" in line or "Banana" in line or "(model)" in line for line in said)
    assert all("the text" in line for line in said), "it says why"
    with model_server("hangs") as (url, _):
        silent = lines_of(study(url, "--consent-to-model", timeout_s=0.2))
    assert all("no answer before the deadline" in line for line in silent)
    words = [line.partition(" (")[0] for line in said]
    assert [line.partition(" (")[0] for line in silent] == words, "the same template"


def test_a_consent_without_a_model_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HANDOVER_TRAINER_MODEL_URL", raising=False)
    with pytest.raises(UsageError, match="HANDOVER_TRAINER_MODEL_URL"):
        perform_study(40.0, print, consents_to_model=True)
