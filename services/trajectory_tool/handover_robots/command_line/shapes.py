"""The shapes of a robot beside the meshes of its manufacturer, and the report of a robot that was added."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from handover_robots.onboarding.comparison import Comparison


def print_shapes(
    name: str, data_dir: Path, meshes: str, *, configurations: int, seed: int, as_json: bool
) -> None:
    """Measure the shapes of a robot, and print the report. Raises `UsageError`."""
    from handover_robots.onboarding.enclosure import measure_shapes  # noqa: PLC0415 - needs the extra
    from handover_robots.robots.folder import load_robot  # noqa: PLC0415

    model = load_robot(name, data_dir, Path())
    report = measure_shapes(model, meshes, configurations, seed)
    if as_json:
        print(json.dumps({"robot": name, "meshes": meshes, **report.as_json()}, indent=2))
        return
    for finding in report.findings:
        print(f"{finding.level:<8} {finding.about}: {finding.text}")
    for link in report.links:
        of_robot = "" if link.link == link.robot_link else f" ({link.robot_link} of {name})"
        print(f"{link.outside_mm:9.3f} mm of {link.link}{of_robot} are outside of the shapes")
    for unmapped, reason in report.unmapped.items():
        print(f"not compared: {unmapped}: {reason}")
    if report.without_mesh:
        print(f"without a mesh: {', '.join(report.without_mesh)}")
    print_comparison(report.comparison)


def print_comparison(comparison: "Comparison") -> None:
    """Print how shapes decide about self-collision, beside the meshes."""
    print(
        f"self-collision in {comparison.configurations:,} uniform positions (seed {comparison.seed}): "
        f"{comparison.free:,} are free by the meshes, of these {_percent(comparison.falsely_refused)} are "
        f"refused by the shapes; {_percent(comparison.falsely_allowed)} of all are allowed, and meshes touch"
    )
    for pair in comparison.pairs:
        if pair.falsely_refused or pair.falsely_allowed:
            print(
                f"  {pair.first}, {pair.second}: {_percent(pair.falsely_refused)} falsely refused, "
                f"{_percent(pair.falsely_allowed)} falsely allowed, meshes touch in {_percent(pair.touching)}"
            )
    for pair in comparison.unchecked:
        print(f"  {pair.first}, {pair.second}: not checked, meshes touch in {_percent(pair.touching)}")


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
