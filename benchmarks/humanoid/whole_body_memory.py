"""The memory of the humanoid's control process over time: it must not grow.

    python -m benchmarks.humanoid.whole_body_memory [--minutes 60]

The process is that of the service, with a real clock. It stands, walks by seeded wishes, is led by the hands,
and stands ready to throw, each for a minute in turn. After the first round of all behaviours the resident
memory may grow by `MAX_GROWTH_MB`; with more the command fails.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.humanoid.whole_body_walking import DEPLOYMENT
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.wish import PERSON, WISH
from handover_humanoid.patterns.regions import SIDES

PART_S, WRITE_S = 60.0, 0.05
ROUND = (None, Behaviour.WALKING, Behaviour.ASSISTED_WALKING, Behaviour.JUGGLING)
MAX_GROWTH_MB = 2.0
"""In the whole time: 0.03 MB a minute in an hour. A leak of 80 bytes a period was 0.45 MB a minute."""
MODULE = "handover_humanoid.control_process"


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    line = next(status_line for status_line in status.splitlines() if status_line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


def of(names: tuple[str, ...], values: dict[str, float]) -> np.ndarray:
    """Return the values of a port, 0 where none is given."""
    return np.array([values.get(name, 0.0) for name in names])


def command(folder: Path, behaviour: Behaviour | None, random: np.random.Generator) -> None:
    """Write what people want, for one part of a round."""
    wish, person = PortWriter(folder / "wish", WISH), PortWriter(folder / "person", PERSON)
    wanted, held = {}, {}
    if behaviour is not None:
        wanted = {"behaviour": float(behaviour), "speed_share": 1.0, "ahead_mps": random.uniform(-0.05, 0.1)}
        wanted["yaw_radps"] = random.uniform(-0.15, 0.15)
    if behaviour is Behaviour.ASSISTED_WALKING:
        pull = {"held": 2.0, "force_x_n": random.uniform(-3.0, 6.0), "force_y_n": random.uniform(-3.0, 3.0)}
        held = {f"{side}.{name}": value for side in SIDES for name, value in pull.items()}
    end_s = time.monotonic() + PART_S
    try:
        while time.monotonic() < end_s:
            wish.write(of(WISH, wanted))
            person.write(of(PERSON, held))
            time.sleep(WRITE_S)
    finally:
        wish.close()
        person.close()


def measure(minutes: float) -> bool:
    """Print the memory each minute; return whether it was flat."""
    random, samples = np.random.default_rng(1), list[float]()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder, file = Path(name), Path(name) / "deployment.yaml"
        file.write_text(DEPLOYMENT.format(folder=folder, fifo="false"), encoding="utf-8")
        with subprocess.Popen(
            [sys.executable, "-m", MODULE, str(file)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        ) as process:
            try:
                while not (folder / "state").exists():
                    time.sleep(0.1)
                state = PortReader(folder / "state")
                for part in range(round(minutes * 60 / PART_S)):
                    behaviour = ROUND[part % len(ROUND)]
                    command(folder, behaviour, random)
                    state.read()
                    samples.append(resident_mb(process.pid))
                    shown = "stands" if behaviour is None else behaviour.name.lower().replace("_", " ")
                    print(
                        f"{(part + 1) * PART_S / 60:4.0f} min, {shown}: {samples[-1]:.1f} MB, "
                        f"{state.value('cycles'):.0f} cycles, mode {state.value('mode'):.0f}",
                        flush=True,
                    )
            finally:
                process.send_signal(signal.SIGTERM)
    later = samples[len(ROUND) :]
    if not later:
        print("no figure: it takes more than one round of the behaviours")
        return False
    growth = later[-1] - later[0]
    print(
        f"after the first round, {growth:+.2f} MB in {len(later) - 1} min (at most {MAX_GROWTH_MB:g} MB), "
        f"{later[0]:.1f} to {later[-1]:.1f} MB"
    )
    return growth <= MAX_GROWTH_MB


def main() -> None:
    """Measure; fail if the memory grew."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    sys.exit(not measure(parser.parse_args().minutes))


if __name__ == "__main__":
    main()
