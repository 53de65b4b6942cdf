"""The waveforms of the page Health in a browser: frames a second, and what each costs.

    python -m benchmarks.page.waveforms [--seconds 20]

A simulated person sends ECG, pulse wave and breathing. Frames are those of `requestAnimationFrame`: the page
moves its plots in each. The cost is the CPU time of all processes of Chromium, of a page of 1920 by 1080;
without a graphics card they also paint. An empty page shows what the browser takes by itself.
"""

import argparse
import asyncio
import os
import tempfile
from collections.abc import Sequence

import httpx
import numpy as np
import psutil
from playwright.async_api import Page, ViewportSize, async_playwright

from benchmarks.body.human_state_limits import add, ready
from benchmarks.cell.handover import environment, stop, up
from benchmarks.free_ports import free_ports
from benchmarks.page.screen import installed_chromium
from benchmarks.steal_time import report_steal_time
from tests.kit.chromium import FLAGS

SIGNALS = ("ecg", "ppg", "respiration")
VIEWPORT: ViewportSize = {"width": 1920, "height": 1080}
FULL_MS = 1000 / 60
WARM_UP_S = 12.0
"""Then the plots of 10 s are full."""
FRAMES = """(seconds) => new Promise((resolve) => {
  const times = [];
  const frame = (at) => {
    times.push(at);
    if (at - times[0] < 1000 * seconds) requestAnimationFrame(frame); else resolve(times);
  };
  requestAnimationFrame(frame);
})"""


async def measure(page: Page, title: str, seconds: float) -> None:
    """Print the frames of what `page` shows."""
    own = psutil.Process()
    browser = [child for child in own.children(recursive=True) if "chrom" in child.name().lower()]

    def cpu_s() -> float:
        return sum(sum(process.cpu_times()[:2]) for process in browser if process.is_running())

    before_s = cpu_s()
    times = np.array(await page.evaluate(FRAMES, seconds))
    used_s = cpu_s() - before_s
    gaps_ms = np.diff(times)
    print(
        f"  {title:24} {1000 * len(gaps_ms) / np.ptp(times):5.1f} frames a second, longest "
        f"{gaps_ms.max():.0f} ms, {100 * np.mean(gaps_ms > 1.5 * FULL_MS):.1f} % late; "
        f"{1000 * used_s / len(gaps_ms):.1f} ms of CPU a frame"
    )


async def run(env: dict[str, str], seconds: float) -> None:
    """Add the person, open the page, and measure."""
    chromium = installed_chromium()
    base = f"http://127.0.0.1:{env['HANDOVER_HUMAN_STATE_PORT']}"
    async with httpx.AsyncClient(base_url=base, timeout=120, trust_env=False) as rest:
        await ready(rest)
        await add(rest, "aino", {"driver": "simulated", "settings": {"signals": SIGNALS}})
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        page = await browser.new_page(viewport=VIEWPORT)
        await measure(page, "an empty page", seconds)
        await page.goto(f"http://127.0.0.1:{env['HANDOVER_WEBUI_PORT']}/health")
        await page.locator(".waveform__pane canvas").nth(len(SIGNALS) - 1).wait_for(timeout=120_000)
        await asyncio.sleep(WARM_UP_S)
        await measure(page, f"{len(SIGNALS)} waveforms", seconds)
        await browser.close()


def main(arguments: Sequence[str] | None = None) -> None:
    """Start a cell with human state, measure, stop it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder, report_steal_time():
        env = {**environment(folder), "HANDOVER_HUMAN_STATE_PORT": str(free_ports(1)[0])}
        cell, _ = up(env)
        try:
            asyncio.run(run(env, options.seconds))
        finally:
            stop(cell)
    print(f"  load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
