"""Ports of tests that run at the same time, in any number of processes."""

import subprocess
import sys

from tests.kit.paths import REPOSITORY
from tests.kit.ports import PORTS, next_free_port

RESERVE = """
from tests.kit import ports
print(*(ports.next_free_port() for _ in range(200)), flush=True)
input()
"""


def test_no_two_processes_get_the_same_port_while_both_run() -> None:
    """The second process begins where the first did, as workers do whose ranges have met."""
    code = RESERVE.replace("print", "ports._order = iter(ports.PORTS); print", 1)
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    try:
        lines = [process.stdout.readline() for process in processes if process.stdout is not None]
    finally:
        for process in processes:
            process.communicate("\n", timeout=120)
    first, second = ({int(port) for port in line.split()} for line in lines)
    assert len(first) == len(second) == 200
    assert not first & second
    assert first | second <= set(PORTS)


def test_a_process_gets_each_of_its_ports_once() -> None:
    ports = [next_free_port() for _ in range(100)]
    assert len(set(ports)) == 100
