"""Runs what takes long, part by part: `make nightly`, and in CI as many parts as fit into its time.

    python -m tests.nightly                          # all parts
    python -m tests.nightly --changed --minutes 50   # those of packages that differ from the newest tag

A part is a target of the Makefile. With a limit, a part starts only if it will probably end in time; the
result says which parts ran, and how long they took, and which did not. A part that fails does not stop the
others.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from tests.kit.failed_tests import MAX_FAILED, failed_in
from tests.kit.paths import REPOSITORY


@dataclass(frozen=True, slots=True)
class Part:
    """A target of the Makefile, its usual duration on two cores, and the folders that it tests."""

    target: str
    minutes: float
    folders: tuple[str, ...]


ALL: Final = ("",)
"""Every folder."""
PARTS: Final = (
    Part("nightly-broker", 8, ("services/context_broker", "handover")),
    Part("nightly-processes", 6, ("services/task_orchestrator", "handover")),
    Part("nightly-robots", 8, ("services/trajectory_tool", "handover")),
    Part("ros-test", 6, ("ros_fiware_bridge", "handover")),
    Part("crashes", 2, ("services/context_broker",)),
    Part("nightly-cell", 8, ALL),
    Part("nightly-humanoid", 4, ("services/whole_body_control", "handover")),
    Part("nightly-devices", 4, ("services/device_gateway", "handover")),
    Part("nightly-body", 4, ("services/human_state", "handover")),
    Part("nightly-ros", 6, ("ros_fiware_bridge", "handover")),
    Part("nightly-gloves", 3, ("services/gesture_controller", "glove_sdk_bridge", "handover")),
    Part("nightly-kit", 3, ("handover",)),
    Part("nightly-web", 3, ("webui", "handover")),
    Part("nightly-accounts", 2, ("services/accounts", "handover")),
    Part("nightly-datamodels", 1, ("datamodels",)),
    Part("nightly-study", 1, ("services/study", "handover")),
    Part("nightly-cases", 1, ("services/assistive_devices", "handover")),
    Part("nightly-alerts", 1, ("services/alert_router", "handover")),
    Part("nightly-project", 2, ALL),
    Part("nightly-page", 15, ALL),
    Part("kill-test", 12, ALL),
    Part("schemathesis", 10, ALL),
    Part("humanoid-memory", 10, ("services/whole_body_control",)),
    Part("containers", 20, ("deploy", "Dockerfile", "docker-compose.yml")),
    Part("lowest", 25, ("pyproject.toml", "requirements")),
    Part("thorough", 30, ALL),
    Part("orion-test", 30, ALL),
)
"""What CI should not leave out comes first."""
OF_MAKE: Final = frozenset({"ARGS", "MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL"})


def main(words: Sequence[str]) -> int:
    """Run the parts; return 1 if one has failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--changed", action="store_true", help="only parts that differ from the newest tag")
    parser.add_argument("--minutes", type=float, help="start no part that would probably end later")
    parser.add_argument("--only", nargs="+", choices=[part.target for part in PARTS], help="these parts")
    options = parser.parse_args(words)
    chosen = [part for part in PARTS if options.only is None or part.target in options.only]
    if options.changed:
        chosen = list(_changed(chosen))
    return run(chosen, options.minutes)


def run(parts: Sequence[Part], minutes: float | None) -> int:
    """Run `parts` one after the other; return 1 if one has failed."""
    begin_s, lines, has_failed = time.monotonic(), [], False
    for part in parts:
        elapsed = (time.monotonic() - begin_s) / 60
        if minutes is not None and elapsed + part.minutes > minutes:
            lines.append(f"not run  {part.target}: no time was left")
            continue
        print(f"== {part.target}", flush=True)
        result = "ok"
        if not _make(part.target):
            result = "repeated" if _repeat_failed(part.target) else "failed"
        has_failed = has_failed or result == "failed"
        took = (time.monotonic() - begin_s) / 60 - elapsed
        lines.append(f"{result:<8} {part.target}: {took:.1f} minutes")
    print("\n".join(["== nightly", *lines]), flush=True)
    return int(has_failed)


def _make(target: str) -> bool:
    """Run a target without the arguments of the `make` that started us."""
    environment = {name: value for name, value in os.environ.items() if name not in OF_MAKE}
    command = ["make", "--no-print-directory", target]
    return subprocess.run(command, cwd=REPOSITORY, env=environment).returncode == 0


def _repeat_failed(part: str) -> bool:
    """Repeat alone the tests of a part that failed; return whether they passed, and were few.

    Beside others a test may fail on a busy machine.
    """
    failed = failed_in([part])
    if not 0 < len(failed) <= MAX_FAILED:
        return False
    print("repeated alone:", *failed, sep="\n", flush=True)
    return (
        subprocess.run([sys.executable, "-m", "pytest", "-n", "0", *failed], cwd=REPOSITORY).returncode == 0
    )


def _changed(parts: Sequence[Part]) -> Iterator[Part]:
    """Yield the parts with files that differ from the newest tag; all without a tag."""
    tag = _git("describe", "--tags", "--abbrev=0")
    if not tag:
        yield from parts
        return
    files = _git("diff", "--name-only", tag[0], "HEAD")
    for part in parts:
        if any(file.startswith(folder) for file in files for folder in part.folders):
            yield part


def _git(*words: str) -> list[str]:
    done = subprocess.run(["git", *words], cwd=REPOSITORY, capture_output=True, text=True)
    return done.stdout.splitlines() if done.returncode == 0 else []


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
