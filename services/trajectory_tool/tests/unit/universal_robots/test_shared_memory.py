"""The memory between the trajectory tool and its exchange process."""

import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ur.shared_memory import (
    SIZE_BYTES,
    Command,
    Report,
    SharedMemory,
)
from handover_ur.states import ExchangeMode

six = st.tuples(*[st.floats(allow_nan=False)] * 6)
numbers = st.integers(-(2**31), 2**31 - 1)


@pytest.fixture
def memory() -> Iterator[SharedMemory]:
    made = SharedMemory.create()
    yield made
    made.close()


commands = st.builds(
    Command,
    st.floats(allow_nan=False),
    st.sampled_from(ExchangeMode),
    numbers,
    six,
    six,
    six,
    st.integers(0, 3),
    st.integers(0, 3),
)


@given(commands)
def test_a_command_is_read_as_it_was_written(command: Command) -> None:
    memory = SharedMemory.create()
    memory.write_command(command)
    assert memory.read_command() == command
    memory.close()


@given(
    st.builds(
        Report, positions=six, velocities=six, torques=six, robot_mode=numbers, reason=st.text(max_size=30)
    )
)
def test_a_report_is_read_as_it_was_written(report: Report) -> None:
    memory = SharedMemory.create()
    memory.write_report(report)
    read = memory.read_report()
    assert read.positions == report.positions
    assert read.torques == report.torques
    assert read.reason == report.reason.rstrip("\0")
    memory.close()


def test_a_long_reason_is_cut(memory: SharedMemory) -> None:
    memory.write_report(Report(reason="ä" * 500))
    assert memory.read_report().reason.startswith("ää")


def test_a_record_that_is_never_completed_is_an_error(memory: SharedMemory) -> None:
    memory.write_report(Report(reason="complete"))
    memory._memory[SIZE_BYTES - 1] ^= 0xFF
    with pytest.raises(OSError, match="incomplete record"):
        memory.read_report()


def test_a_reader_never_sees_half_of_a_command(memory: SharedMemory) -> None:
    ended = threading.Event()

    def write() -> None:
        for number in range(20_000):
            memory.write_command(Command(positions=(float(number),) * 6, velocities=(float(number),) * 6))
        ended.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not ended.is_set():
        command = memory.read_command()
        assert len({*command.positions, *command.velocities}) == 1
    writer.join()
