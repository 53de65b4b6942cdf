"""The screen in a browser: how fast it answers.

    python -m benchmarks.page.screen [--answers 40]

An answer is timed inside the page: from the press of a button, or from the frame that completes a hold, to
the next frame the browser paints after the page has changed.
"""

import argparse
import asyncio
import shutil
import statistics
import sys
import tempfile
import time
from typing import Any

import httpx
from playwright.async_api import Browser, async_playwright

from benchmarks.cell.handover import HOLD_S, OPEN_HAND, SETTLE_S, Hand, compare, environment, stop, up
from tests.kit.chromium import FLAGS

MAX_RESPONSE_MS = 100.0

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
    took: dict[str, list[float]] = {"complete by hand": [], "gesture held": []}
    async with httpx.AsyncClient(base_url=f"{base}/api", trust_env=False, timeout=30) as http:
        levels = {
            "fist": [[100 + i % 3] * 5 for i in range(50)],
            "open": [[1000 + i % 3] * 5 for i in range(50)],
        }
        await calibrated(http, levels)
        hand = Hand(int(env["HANDOVER_GLOVE_PORT"]))
        by_hand = True
        while min(len(times) for times in took.values()) < count:
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


def installed_chromium() -> str:
    """Return the browser as people use it; tests start it in another way (`tests.kit.chromium`)."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("Chromium is not installed; on Debian and Ubuntu: sudo apt install chromium")
    return browser


async def measure(env: dict[str, str], answers: int) -> None:
    """Measure and print."""
    chromium = installed_chromium()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=chromium, args=list(FLAGS))
        for what, times in (await measure_answers(env, browser, answers)).items():
            ordered = sorted(times)
            p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
            compare(f"{what}, median", statistics.median(ordered), MAX_RESPONSE_MS, "ms")
            compare(f"{what}, p99", p99, MAX_RESPONSE_MS, "ms")
        await browser.close()


def main() -> None:
    """Start a cell, measure, stop it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--answers", type=int, default=40)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data_dir:
        env = {**environment(data_dir), "HANDOVER_ANNOUNCE_MS": "100", "HANDOVER_CONFIRM_MS": "300"}
        process, _ = up(env)
        try:
            asyncio.run(measure(env, options.answers))
        finally:
            stop(process)


if __name__ == "__main__":
    sys.exit(main())
