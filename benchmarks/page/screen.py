"""The screen in a browser: how fast it answers, and whether its memory grows.

    python -m benchmarks.page.screen [--answers 40] [--minutes 10]

An answer is timed inside the page: from the press of a button, or from the frame that completes a hold, to
the next frame the browser paints after the page has changed. For the memory a simulated operator and a
simulated robot run the bin-picking process again and again while the Work and the System page are open;
the JavaScript heap is weighed after a collection, and a straight line through the second half is its slope.
"""

import argparse
import asyncio
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import httpx
import psutil
from playwright.async_api import Browser, CDPSession, Page, async_playwright

from benchmarks.cell.handover import HOLD_S, OPEN_HAND, SETTLE_S, Hand, compare, environment, stop, up
from tests.kit.chromium import FLAGS

MAX_RESPONSE_MS = 100.0
SAMPLE_S = 20.0

# `painted` is when the page has painted what `watchFor` was given, which is not there yet.
WATCH = """
window.watchFor = (selector) => { window.painted = new Promise((resolve, reject) => {
  const isThere = () => document.querySelector(selector) !== null;
  if (isThere()) reject(new Error(`${selector} is there already`));
  const seen = new MutationObserver(() => {
    if (!isThere()) return;
    seen.disconnect();
    requestAnimationFrame(() => setTimeout(() => resolve(performance.timeOrigin + performance.now()), 0));
  });
  seen.observe(document.body, { subtree: true, childList: true, attributeFilter: ["data-situation"] });
}); };
document.addEventListener("pointerdown", (event) => {
  window.pressedAt = performance.timeOrigin + event.timeStamp;
}, true);
"""
ANSWERED = "[data-situation='answered']"
SINCE_PRESSED = "painted.then((at) => at - window.pressedAt)"


async def measure_answers(env: dict[str, str], browser: Browser, count: int) -> dict[str, list[float]]:
    """Return the milliseconds that the page takes to answer, by what was done."""
    base = f"http://127.0.0.1:{env['HANDOVER_WEBUI_PORT']}"
    context = await browser.new_context(
        base_url=base, viewport={"width": 1280, "height": 800}, locale="en-GB"
    )
    await context.add_init_script("localStorage.setItem('handover.who', 'Anna')")
    await context.add_init_script(WATCH)
    page = await context.new_page()
    await page.goto("/work?glove=glove-1")
    took: dict[str, list[float]] = {"open another page": [], "complete by hand": [], "gesture held": []}
    async with httpx.AsyncClient(base_url=f"{base}/api", trust_env=False, timeout=30) as http:
        levels = {
            "fist": [[100 + i % 3] * 5 for i in range(50)],
            "open": [[1000 + i % 3] * 5 for i in range(50)],
        }
        await calibrated(http, levels)
        hand = Hand(int(env["HANDOVER_GLOVE_PORT"]))
        by_hand = True
        while min(len(times) for name, times in took.items() if name != "open another page") < count:
            code = await asked_of(http)
            keeping = asyncio.create_task(hand.show(OPEN_HAND, SETTLE_S))
            await page.locator("[data-situation='prompt']").wait_for()
            await keeping
            if by_hand:
                keeping = asyncio.create_task(hand.show(OPEN_HAND, 0.5))
                await page.evaluate(f'watchFor("{ANSWERED}")')
                await page.get_by_role("button", name="Complete by hand").click()
                took["complete by hand"].append(float(await page.evaluate(SINCE_PRESSED)))
                await keeping
            else:
                await page.evaluate(f'watchFor("{ANSWERED}")')
                bend = [1000 if finger == "0" else 100 for finger in code]
                offset_s = time.time() - time.perf_counter()
                sent_s = await hand.show(bend, HOLD_S)
                took["gesture held"].append(
                    float(await page.evaluate("painted")) - 1000 * (sent_s + offset_s)
                )
            by_hand = not by_hand
        hand.link.close()
        for nth in range(count):
            name = ["Processes", "Work"][nth % 2]
            await page.evaluate(f'watchFor(".{name.lower()}")')
            await page.get_by_role("navigation").get_by_role("link", name=name).click()
            took["open another page"].append(float(await page.evaluate(SINCE_PRESSED)))
            await asyncio.sleep(0.2)
    await context.close()
    return {name: times[2:] for name, times in took.items()}  # the first ones load what they show


async def calibrated(http: httpx.AsyncClient, levels: dict[str, Any]) -> None:
    """Let the glove's thresholds fit the levels that the hand here has."""
    (await http.put("/gesture-controller/gloves/glove-1", json={"hand": "right"})).raise_for_status()
    (await http.post("/gesture-controller/gloves/glove-1/calibration", json=levels)).raise_for_status()


async def asked_of(http: httpx.AsyncClient) -> str:
    """Return the code of the gesture that the next Task asks for; starts a process where none runs."""
    while True:
        view = (await http.get("/gesture-controller/gloves/glove-1")).json()
        if view["task"] is not None and view["task"]["status"] == "inProgress":
            return str(view["task"]["code"])
        running = (await http.get("/task-orchestrator/processes", params={"status": "inProgress"})).json()
        if not running:
            await http.post("/task-orchestrator/processes", json={"definition": "bin-picking"})
        await asyncio.sleep(0.1)


async def measure_memory(
    env: dict[str, str], browser: Browser, minutes: float
) -> dict[str, list[tuple[float, float]]]:
    """Return (minutes, MB) of the heaps of two pages and of the resident memory of the screen's server."""
    base = f"http://127.0.0.1:{env['HANDOVER_WEBUI_PORT']}"
    weigh: dict[str, Callable[[], Awaitable[float]]] = {}
    for name, path in (("Work page", "/work?glove=glove-1"), ("System page", "/system?tab=robots")):
        context = await browser.new_context(base_url=base, viewport={"width": 1280, "height": 800})
        page = await context.new_page()
        await page.goto(path)
        weigh[name] = heap_of(page, await context.new_cdp_session(page))
    server = next(p for p in psutil.process_iter(["cmdline"]) if is_server(p, env))
    weigh["server"] = resident_of(server)
    samples: dict[str, list[tuple[float, float]]] = {name: [] for name in weigh}
    began_s = time.monotonic()
    async with httpx.AsyncClient(base_url=f"{base}/api", trust_env=False, timeout=30) as http:
        (await http.post("/operator", json={"glove": "glove-1"})).raise_for_status()
        while (now_s := time.monotonic() - began_s) < 60 * minutes:
            running = (await http.get("/task-orchestrator/processes", params={"status": "inProgress"})).json()
            if not running:
                await http.post("/task-orchestrator/processes", json={"definition": "bin-picking"})
            if now_s >= SAMPLE_S * len(samples["server"]):
                for name, weight in weigh.items():
                    samples[name].append((now_s / 60, await weight()))
            await asyncio.sleep(1)
    return samples


def is_server(process: psutil.Process, env: dict[str, str]) -> bool:
    """Say whether a process is the screen's server of this measurement."""
    if " ".join(process.info["cmdline"] or []).split()[-2:] != ["-m", "handover_web"]:
        return False
    listening = {c.laddr.port for c in process.net_connections() if c.status == psutil.CONN_LISTEN}
    return int(env["HANDOVER_WEBUI_PORT"]) in listening


def heap_of(page: Page, session: CDPSession) -> Callable[[], Awaitable[float]]:
    """Return what weighs the JavaScript heap of a page, in MB, after a collection."""

    async def weigh() -> float:
        await page.bring_to_front()
        await session.send("HeapProfiler.collectGarbage")
        usage = await session.send("Runtime.getHeapUsage")
        return float(usage["usedSize"]) / 2**20

    return weigh


def resident_of(process: psutil.Process) -> Callable[[], Awaitable[float]]:
    """Return what weighs the resident memory of a process, in MB."""

    async def weigh() -> float:
        return float(process.memory_info().rss) / 2**20

    return weigh


def slope_mb_per_h(samples: Sequence[tuple[float, float]]) -> float:
    """Return the slope of a straight line through the second half, after everything has loaded once."""
    late = samples[len(samples) // 2 :]
    if len(late) < 2:
        return float("nan")
    return 60 * statistics.linear_regression([at for at, _ in late], [mb for _, mb in late]).slope


def installed_chromium() -> str:
    """Return the browser as people use it; tests start it in another way (`tests.kit.chromium`)."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("Chromium is not installed; on Debian and Ubuntu: sudo apt install chromium")
    return browser


async def measure(env: dict[str, str], answers: int, minutes: float) -> None:
    """Measure and print."""
    chromium = installed_chromium()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        for what, times in (await measure_answers(env, browser, answers)).items() if answers else ():
            ordered = sorted(times)
            p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
            compare(f"{what}, median", statistics.median(ordered), MAX_RESPONSE_MS, "ms")
            compare(f"{what}, p99", p99, MAX_RESPONSE_MS, "ms")
        if minutes > 0:
            for what, samples in (await measure_memory(env, browser, minutes)).items():
                first, last, slope = samples[0][1], samples[-1][1], slope_mb_per_h(samples)
                print(
                    f"{what:<36} {first:7.1f} MB at first, {last:.1f} MB after {minutes:g} min, "
                    f"{slope:+.1f} MB/h"
                )
        await browser.close()


def main() -> None:
    """Start a cell, measure, stop it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--answers", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data_dir:
        for confirm_ms, answers, minutes in (("300", options.answers, 0.0), ("1500", 0, options.minutes)):
            if not answers and not minutes:
                continue
            env = {**environment(data_dir), "HANDOVER_ANNOUNCE_MS": "100", "HANDOVER_CONFIRM_MS": confirm_ms}
            process: subprocess.Popen[str]
            process, _ = up(env)
            try:
                asyncio.run(measure(env, answers, minutes))
            finally:
                stop(process)


if __name__ == "__main__":
    sys.exit(main())
