"""Table I of the paper beside the measured trials, as text, CSV and JSON."""

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from statistics import mean
from typing import Any, Final

from handover_robots.case_study.trial import Mode, Outcome


@dataclass(frozen=True, slots=True)
class Published:
    """What Table I of the IoHRT paper has for an object: s, and the share of successes."""

    without_s: float
    without: float
    with_s: float
    with_: float


TABLE_1: Final = {
    "cube": Published(14, 1.0, 24, 1.0),
    "apple": Published(18, 0.8, 28, 1.0),
    "chilli": Published(18, 0.8, 32, 1.0),
    "orange": Published(22, 0.6, 28, 0.6),
    "pantyhose": Published(20, 1.0, 40, 1.0),
    "yellow-glove": Published(17, 0.8, 44, 1.0),
    "pink-glove": Published(21, 1.0, 52, 1.0),
    "jacket": Published(35, 0.2, 72, 0.8),
}
PUBLISHED_MEAN: Final = Published(20.6, 0.775, 40.0, 0.925)

NOTE: Final = (
    "Paper: Table I of the IoHRT paper, a real Panda with a soft gripper and people. Here: MuJoCo, the hand "
    "of the Panda, cloth as articulated patches, a simulated person, one autonomous attempt. It shows "
    "what this simulation does; they neither confirm nor refute the paper."
)


def cell(outcomes: Sequence[Outcome]) -> str:
    """Return the mean time and the share of successes."""
    if not outcomes:
        return "-"
    return f"{mean(outcome.time_s for outcome in outcomes):5.1f} s {_share(outcomes):4.0%}"


def text(outcomes: Sequence[Outcome]) -> str:
    """Return the table."""
    lines = [
        f"{'':<13} {'paper':^25} | {'measured here':^38}",
        f"{'':<13} {'without':>12} {'with':>12} | " + " ".join(f"{mode:>13}" for mode in Mode),
    ]
    things = [name for name in TABLE_1 if any(outcome.thing == name for outcome in outcomes)]
    for name, published in [*((name, TABLE_1[name]) for name in things), ("mean", PUBLISHED_MEAN)]:
        own = [outcome for outcome in outcomes if name in ("mean", outcome.thing)]
        columns = (cell([outcome for outcome in own if outcome.mode is mode]) for mode in Mode)
        lines.append(
            f"{name:<13} {published.without_s:5.1f} s {published.without:5.1%}"
            f" {published.with_s:5.1f} s {published.with_:5.1%} | "
            + " ".join(f"{column:>13}" for column in columns)
        )
    seeds = sorted({outcome.seed for outcome in outcomes})
    cpu_s, time_s = sum(outcome.cpu_s for outcome in outcomes), sum(outcome.time_s for outcome in outcomes)
    lines += [
        "",
        f"seeds {', '.join(map(str, seeds))}; {len(outcomes)} trials, {time_s:.0f} s simulated in "
        f"{cpu_s:.0f} s of CPU time ({time_s / max(cpu_s, 1e-9):.1f} times real time on one core)",
        NOTE,
    ]
    return "\n".join(lines)


def write(outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write `trials.csv` and `results.json` into a folder. Raises `OSError`."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(outcome) for outcome in outcomes]
    with (folder / "trials.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Outcome)])
        writer.writeheader()
        writer.writerows(rows)
    summary: dict[str, Any] = {
        "note": NOTE,
        "paper": {name: asdict(published) for name, published in {**TABLE_1, "mean": PUBLISHED_MEAN}.items()},
        "measured": {
            str(mode): _means([outcome for outcome in outcomes if outcome.mode is mode]) for mode in Mode
        },
        "trials": rows,
    }
    (folder / "results.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")


def _share(outcomes: Sequence[Outcome]) -> float:
    return sum(outcome.is_success for outcome in outcomes) / len(outcomes)


def _means(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float]]:
    """Return number, share of successes and mean time of the trials of each object, and of all."""
    return {
        name: {
            "trials": len(own),
            "success": _share(own),
            "meanTimeS": mean(outcome.time_s for outcome in own),
        }
        for name in (*TABLE_1, "mean")
        if (own := [outcome for outcome in outcomes if name in ("mean", outcome.thing)])
    }
