"""Virtual reality in Chromium with an emulated headset: how long the way from a pose to its picture takes.

    python -m benchmarks.humanoid_vr [--seconds 20]

The page measures itself (*Measure*). Chromium draws in software here, in stereo and small. The drawn picture
is waited for, so `ownHands` and `poseDrawn` include the drawing. The display of a headset comes on top of it.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import psutil
from playwright.sync_api import Page, sync_playwright

from benchmarks.screen import installed_chromium
from tests.kit.cell import new_cell
from tests.kit.chromium import FLAGS

EMULATOR = Path(__file__).parents[1] / "webui/app/node_modules/iwer/build/iwer.min.js"
WEAR = "new IWER.XRDevice(IWER.metaQuest3).installRuntime({ forceInstall: true });"
SMALL = {"width": 320, "height": 240}
GOAL_MS = 30.0


def rows(page: Page) -> dict[str, tuple[float, float, int]]:
    """Return median, 99 % and count by what was measured, in ms."""
    found = page.locator("[data-median]").evaluate_all("all => all.map((each) => ({ ...each.dataset }))")
    return {one["measured"]: (float(one["median"]), float(one["p99"]), int(one["count"])) for one in found}


def measure(seconds: float) -> dict[str, tuple[float, float, int]]:
    """Start a cell with a humanoid, wear a headset, and return what the page measured."""
    with (
        tempfile.TemporaryDirectory() as data_dir,
        new_cell(Path(data_dir)) as cell,
        sync_playwright() as play,
    ):
        folder = Path(data_dir) / "ports"
        cell.extra = {
            "HANDOVER_HUMANOID_MODEL": "coman",
            "HANDOVER_HUMANOID_PORTS_DIR": str(folder),
            "HANDOVER_HUMANOID_FIFO": "false",
        }
        cell.run("context_broker", "whole_body_control", "webui")
        browser = play.chromium.launch(executable_path=installed_chromium(), args=list(FLAGS))
        try:
            page = browser.new_page(base_url=cell.url("webui"), viewport=SMALL)
            page.add_init_script(f"{EMULATOR.read_text()}\n{WEAR}")
            page.goto("/humanoid/vr")
            page.get_by_text("Measure", exact=True).click()
            page.get_by_role("button", name="Enter virtual reality").click()
            page.locator("[data-measured=poseDrawn][data-count]").wait_for(timeout=180_000)
            page.wait_for_timeout(1000 * seconds)
            return rows(page)
        finally:
            browser.close()
            cell.stop()
            pid = int((folder / "control.pid").read_text())
            if psutil.pid_exists(pid) and str(folder) in " ".join(psutil.Process(pid).cmdline()):
                psutil.Process(pid).terminate()


def main() -> None:
    """Print median and 99 %."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=20.0)
    found = measure(parser.parse_args().seconds)
    for name, (median, p99, count) in found.items():
        print(f"{name:12} median {median:7.1f} ms   99 % {p99:7.1f} ms   of {count}")
    print(f"goal of ownHands {GOAL_MS:g} ms; load {psutil.getloadavg()[0]:.1f} on {psutil.cpu_count()} cores")


if __name__ == "__main__":
    sys.exit(main())
