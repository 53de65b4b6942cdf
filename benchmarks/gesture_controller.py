"""The gesture controller: how fast a frame becomes a held gesture, and what fifty gloves cost.

    python -m benchmarks.gesture_controller [--data FOLDER] [--gloves 50] [--hz 100] [--seconds 10]

First the whole pipeline on one core, from the line on the wire to the hold; with `--data` also how well the
recordings there (CSV: pose, thumb, index, middle, ring, little) are understood after calibrating with poses 0
and 5. Then the real process with gloves on TCP connections: the share of a core that it uses.
"""

import argparse
import asyncio
import csv
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace

import httpx
import orjson
import psutil

from services.gesture_controller.calibration.levels import calibrate
from services.gesture_controller.configuration import built_in
from services.gesture_controller.frames import Frame, Hello, parse_frame
from services.gesture_controller.gestures import M2O2P_GESTURES, Gestures
from services.gesture_controller.glove import Glove
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.pipeline import Senses, Sight, see
from services.gesture_controller.thresholds import FINGERS, M2O2P_THRESHOLDS

FLOOR_FRAMES_PER_S = 20_000
CEILING_CORE_SHARE = 0.40
STRAIGHT, BENT = [2000.0] * 5, [100.0] * 5
RECORDINGS = Path(__file__).parents[2] / "shared" / "data" / "glove_recordings"
CODES = {"1": "20222", "2": "20022", "3": "22000", "6": "02220", "8": "00222"}
"""The recorded poses that are among the 21 gestures."""


def wire_lines(count: int) -> list[bytes]:
    """Return frames as they come over the wire at 100 Hz: a gesture a second and an open hand between."""
    codes = list(M2O2P_GESTURES.values())
    lines = []
    for number in range(count):
        second, rest = divmod(number, 250)
        code = codes[second % len(codes)] if rest < 200 else "00000"
        bend = [
            round((straight if state == "0" else bent) + number % 7)
            for state, straight, bent in zip(code, STRAIGHT, BENT, strict=True)
        ]
        frame = {"type": "frame", "seq": number, "t": round(number / 100, 3), "bend": bend}
        lines.append(orjson.dumps({**frame, "pressure": [0] * 5}))
    return lines


def measure_pipeline(count: int) -> tuple[float, list[float]]:
    """Return frames a second from line to hold in one glove, and the microseconds of each of 20,000."""
    lines = wire_lines(count)
    glove = quiet_glove()
    began = time.perf_counter()
    for line in lines:
        glove.take(parse_frame(line), line, 0.0)
    per_second = count / (time.perf_counter() - began)
    assert glove.frames == count
    glove = quiet_glove()
    took = []
    for line in lines[:20_000]:
        before = time.perf_counter_ns()
        glove.take(parse_frame(line), line, 0.0)
        took.append((time.perf_counter_ns() - before) / 1000)
    return per_second, took


def quiet_glove() -> Glove:
    """Return a glove that nobody listens to."""
    site = built_in()
    nobody = SimpleNamespace(**dict.fromkeys(("state_changed", "went_silent", "came_back"), lambda _: None))
    senses = Senses(M2O2P_THRESHOLDS, site.gestures)
    glove = Glove(
        "glove-1",
        hand="right",
        person=None,
        senses=senses,
        commands=site.commands,
        filtering=True,
        listener=nobody,
    )
    glove.connect(SimpleNamespace(end=lambda _: None), Hello("glove-1"), 0.0)
    return glove


def understood(folder: Path) -> Iterator[str]:
    """Yield a line for each recording in `folder`: the share of frames read right, and what was confirmed."""
    for file in sorted(folder.glob("*.csv")):
        with file.open() as rows:
            poses = {
                pose: [[float(row[finger]) for finger in FINGERS] for row in group]
                for pose, group in groupby(csv.DictReader(rows), key=lambda row: row["pose"])
            }
        if not {"0", "5"} <= poses.keys():
            yield f"  {file.name}: poses 0 (fist) and 5 (open hand) are needed to calibrate"
            continue
        gestures = Gestures(M2O2P_GESTURES)
        senses = Senses(calibrate(poses["0"], poses["5"]).thresholds, gestures)
        shares, wrong = [], 0
        for pose, frames in poses.items():
            right, confirmed = read_pose(frames, senses, gestures.names.get(CODES.get(pose, ""), ""))
            wrong += sum(name != gestures.names.get(CODES.get(pose, "")) for name in confirmed)
            if pose in CODES:
                shares.append(f"pose {pose} {right:.1%}")
        yield f"  {file.name}: {', '.join(shares)}; wrong gestures confirmed: {wrong}"


def read_pose(frames: Sequence[list[float]], senses: Senses, meant: str) -> tuple[float, list[str | None]]:
    """Return the share of `frames` (50 Hz) read as `meant`, and the gestures that were confirmed."""
    sight, right, confirmed = Sight(), 0, []
    for number, bend in enumerate(frames):
        sight = see(sight, Frame(number / 50, bend), senses)
        right += sight.gesture == meant
        if sight.hold.last is HoldEvent.CONFIRMED:
            confirmed.append(sight.gesture)
    return right / len(frames), confirmed


@dataclass(frozen=True)
class Crowd:
    """How many gloves, how fast, how long."""

    gloves: int
    hz: float
    seconds: float


async def measure_gloves(crowd: Crowd) -> tuple[float, float]:
    """Return the share of a core that the real process uses, and the frames a second that it took."""
    with tempfile.TemporaryDirectory() as data_dir:
        broker, port, glove_port = free_ports(3)
        environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")},
            "HANDOVER_DATA_DIR": data_dir,
            "HANDOVER_BROKER_PORT": str(broker),
            "HANDOVER_BROKER_URL": f"http://127.0.0.1:{broker}",
            "HANDOVER_CONTROLLER_PORT": str(port),
            "HANDOVER_GLOVE_PORT": str(glove_port),
            "HANDOVER_LOG_LEVEL": "error",
        }
        processes = [
            subprocess.Popen([sys.executable, "-m", f"services.{name}"], env=environment)
            for name in ("context_broker", "gesture_controller")
        ]
        try:
            async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", trust_env=False) as http:
                await until_ready(http)
                return await load(http, psutil.Process(processes[1].pid), glove_port, crowd)
        finally:
            for process in processes:
                process.terminate()
                process.wait(timeout=10)


async def load(
    http: httpx.AsyncClient, process: psutil.Process, port: int, crowd: Crowd
) -> tuple[float, float]:
    """Stream the frames of a crowd of gloves and watch what `process` uses."""
    streaming = [
        asyncio.create_task(stream(port, f"bench-{number}", crowd.hz)) for number in range(crowd.gloves)
    ]
    try:
        while sum(view["connected"] for view in (await http.get("/gloves")).json()) < crowd.gloves:
            await asyncio.sleep(0.1)
        before, began = cpu_s(process), time.perf_counter()
        frames = sum(view["frames"] for view in (await http.get("/gloves")).json())
        await asyncio.sleep(crowd.seconds)
        took = time.perf_counter() - began
        share = (cpu_s(process) - before) / took
        frames = sum(view["frames"] for view in (await http.get("/gloves")).json()) - frames
    finally:
        for one in streaming:
            one.cancel()
        await asyncio.gather(*streaming, return_exceptions=True)
    return share, frames / took


async def stream(port: int, name: str, hz: float) -> None:
    """Be a glove: a new frame every 1/`hz` seconds, each sent by itself."""
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(orjson.dumps({"type": "hello", "version": 1, "glove": name, "hand": "right"}) + b"\n")
        lines = wire_lines(1000)
        loop = asyncio.get_running_loop()
        began, number = loop.time(), 0
        while True:
            line = orjson.loads(lines[number % len(lines)])
            writer.write(orjson.dumps({**line, "seq": number, "t": number / hz}) + b"\n")
            await writer.drain()
            number += 1
            await asyncio.sleep(max(began + number / hz - loop.time(), 0))
    finally:
        writer.close()


async def until_ready(http: httpx.AsyncClient) -> None:
    """Wait until the controller says that it is ready."""
    async with asyncio.timeout(30):
        while True:
            try:
                if (await http.get("/readyz")).is_success:
                    return
            except httpx.TransportError:
                pass
            await asyncio.sleep(0.1)


def cpu_s(process: psutil.Process) -> float:
    """Return the processor seconds that `process` has used."""
    used = process.cpu_times()
    return float(used.user + used.system)


def free_ports(count: int) -> list[int]:
    """Return ports that nobody listens on."""
    probes = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [int(probe.getsockname()[1]) for probe in probes]
    for probe in probes:
        probe.close()
    return ports


def main() -> None:
    """Measure and print; exit 1 when a floor is missed."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--data", type=Path, default=RECORDINGS, help="folder of recordings (CSV)")
    options.add_argument("--frames", type=int, default=200_000)
    options.add_argument("--gloves", type=int, default=50)
    options.add_argument("--hz", type=float, default=100)
    options.add_argument("--seconds", type=float, default=10)
    chosen = options.parse_args()

    per_second, took = measure_pipeline(chosen.frames)
    median, p99 = statistics.median(took), statistics.quantiles(took, n=100)[98]
    print("pipeline, one core, line on the wire to hold:")
    print(f"  {per_second:,.0f} frames/s (floor {FLOOR_FRAMES_PER_S:,})")
    print(f"  median {median:.1f} µs, p99 {p99:.1f} µs a frame")
    print("recordings, calibrated with poses 0 and 5:")
    if chosen.data.is_dir():
        for line in understood(chosen.data):
            print(line)
    else:
        print(f"  left out: {chosen.data} is not here")
    share, rate = asyncio.run(measure_gloves(Crowd(chosen.gloves, chosen.hz, chosen.seconds)))
    print(f"the process with {chosen.gloves} gloves at {chosen.hz:g} Hz for {chosen.seconds:g} s:")
    print(f"  {rate:,.0f} frames/s taken, {share:.1%} of a core (ceiling {CEILING_CORE_SHARE:.0%})")
    raise SystemExit(per_second < FLOOR_FRAMES_PER_S or share > CEILING_CORE_SHARE)


if __name__ == "__main__":
    main()
