"""The gesture controller: how fast a frame becomes a held gesture, and what fifty gloves cost.

    python -m benchmarks.gloves.gesture_controller [--data FOLDER] [--gloves 50] [--hz 100] [--seconds 10]

First the whole pipeline on one core, from the line on the wire to the hold, with either recognizer. Then how
well the gestures in recordings are recognized (`recorded_hands.py` says how they are measured). Then the real
process with gloves on TCP connections: the share of a core that it uses.
"""

import argparse
import asyncio
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import httpx
import orjson
import psutil

from benchmarks.free_ports import free_ports
from benchmarks.gloves.recorded_hands import report
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.gloves.glove import Glove
from handover_gloves.recognition.frames import Hello, parse_frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES
from handover_gloves.recognition.levels import calibrate
from handover_gloves.recognition.pipeline import RecognitionConfig
from handover_gloves.recognition.registry import PERSONAL
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS

MIN_FRAMES_PER_S = 20_000
MAX_US = 100
MAX_CORE_SHARE = 0.40
STRAIGHT, BENT = [2000.0] * 5, [100.0] * 5
RECORDINGS = Path(__file__).parents[3] / "shared" / "data" / "glove_recordings"
LISTENER_EVENTS = ("state_changed", "went_silent", "came_back", "needs_calibration", "calibration_restored")


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


def measure_pipeline(count: int, make_glove: Callable[[], Glove]) -> tuple[float, list[float]]:
    """Return frames a second from line to hold in one glove, and the microseconds of each of 20,000."""
    lines = wire_lines(count)
    glove = make_glove()
    began = time.perf_counter()
    for line in lines:
        glove.receive(parse_frame(line), line, 0.0)
    per_second = count / (time.perf_counter() - began)
    assert glove.connection.traffic.frames == count
    glove = make_glove()
    took = []
    for line in lines[:20_000]:
        before = time.perf_counter_ns()
        glove.receive(parse_frame(line), line, 0.0)
        took.append((time.perf_counter_ns() - before) / 1000)
    return per_second, took


def quiet_glove() -> Glove:
    """Return a glove that nobody listens to."""
    site = built_in()
    nobody = SimpleNamespace(**dict.fromkeys(LISTENER_EVENTS, lambda *_: None))
    config = RecognitionConfig(M2O2P_THRESHOLDS, site.gestures)
    glove = Glove(
        "glove-1",
        hand="right",
        person=None,
        config=config,
        commands=site.commands,
        filtering=True,
        listener=nobody,
    )
    glove.connect(SimpleNamespace(end=lambda _: None), Hello("glove-1"), 0.0)
    return glove


def personal_glove() -> Glove:
    """Return a glove that nobody listens to, calibrated and read by the personal recognizer."""
    glove = quiet_glove()
    calibration = calibrate([BENT] * 50, [STRAIGHT] * 50)
    glove.configure(replace(glove.reader.config, calibration=calibration, recognizer_name=PERSONAL))
    assert glove.reader.config.missing is None
    return glove


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
            "HANDOVER_MAX_GLOVES": str(crowd.gloves + 1),
            "HANDOVER_MAX_UNDECLARED_GLOVES": str(crowd.gloves),
        }
        processes = [
            subprocess.Popen([sys.executable, "-m", name], env=environment)
            for name in ("handover_broker", "handover_gloves")
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
        for glove in streaming:
            glove.cancel()
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


def print_speed(count: int) -> tuple[float, float]:
    """Print how fast both recognizers are; return frames/s of the first, µs a frame of the second."""
    per_second, took = measure_pipeline(count, quiet_glove)
    print("pipeline, one core, line on the wire to hold:")
    print(f"  {per_second:,.0f} frames/s (limit {MIN_FRAMES_PER_S:,}), {_spread(took)}")
    _, took = measure_pipeline(min(count, 20_000), personal_glove)
    print(f"  personal recognizer: {_spread(took)} (ceiling {MAX_US} µs)")
    return per_second, statistics.median(took)


def _spread(took: Sequence[float]) -> str:
    p99 = statistics.quantiles(took, n=100)[98]
    return f"median {statistics.median(took):.1f} µs, p99 {p99:.1f} µs a frame"


def main() -> None:
    """Measure and print; exit 1 when a limit is missed."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--data", type=Path, default=RECORDINGS, help="folder of recordings (CSV)")
    options.add_argument("--recorded-hz", type=float, default=50, help="frames a second in them")
    options.add_argument("--only-data", action="store_true", help="measure the recordings alone")
    options.add_argument("--frames", type=int, default=200_000)
    options.add_argument("--gloves", type=int, default=50)
    options.add_argument("--hz", type=float, default=100)
    options.add_argument("--seconds", type=float, default=10)
    chosen = options.parse_args()

    if not chosen.only_data:
        per_second, personal_us = print_speed(chosen.frames)
    print(f"recordings, taken for {chosen.recorded_hz:g} Hz:")
    if chosen.data.is_dir():
        for line in report(chosen.data, round(chosen.recorded_hz)):
            print(line, flush=True)
    else:
        print(f"  left out: {chosen.data} is not here")
    if chosen.only_data:
        return
    share, rate = asyncio.run(measure_gloves(Crowd(chosen.gloves, chosen.hz, chosen.seconds)))
    print(f"the process with {chosen.gloves} gloves at {chosen.hz:g} Hz for {chosen.seconds:g} s:")
    print(f"  {rate:,.0f} frames/s taken, {share:.1%} of a core (ceiling {MAX_CORE_SHARE:.0%})")
    too_slow = per_second < MIN_FRAMES_PER_S or personal_us > MAX_US
    raise SystemExit(too_slow or share > MAX_CORE_SHARE)


if __name__ == "__main__":
    main()
