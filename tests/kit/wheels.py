"""The wheels of all our distributions, built from this work tree, and environments with some of them."""

import functools
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from requirements.subset import members, members_of, subset
from tests.kit.paths import REPOSITORY


def run(*words: str | Path, cwd: Path = REPOSITORY, env: dict[str, str] | None = None) -> str:
    """Run a command to its end and return its output; fail with the output if it fails."""
    done = subprocess.run(
        list(map(str, words)),
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=600,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, f"{done.args}: {done.stdout}{done.stderr}"
    return done.stdout


def packages_of(name: str) -> list[Path]:
    """Return the folders of the import packages of a distribution."""
    member = members()[name]
    packages = member["tool"]["hatch"]["build"]["targets"]["wheel"].get("packages", ["."])
    return [REPOSITORY / member["folder"] / package for package in packages]


@functools.cache
def wheel_of(name: str, place: Path) -> Path:
    """Build the wheel of a distribution in a folder of its own in `place`."""
    folder = place / name
    project = REPOSITORY / members()[name]["folder"]
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=project)
    return next(folder.glob("*.whl"))


def install(distributions: Sequence[str], environment: Path, place: Path) -> None:
    """Make a virtual environment with `distributions` and what the lock says they need."""
    uv = (sys.executable, "-m", "uv")
    run(*uv, "venv", "--quiet", "--python", sys.executable, environment)
    into = (*uv, "pip", "install", "--quiet", "--python", environment / "bin" / "python")
    locked = environment / "requirements.txt"
    locked.write_text(subset(distributions), encoding="utf-8")
    if locked.stat().st_size:
        run(*into, "--require-hashes", "-r", locked)
    folders = members_of(distributions)
    names = [name for name, member in members().items() if member["folder"] in folders]
    run(*into, "--no-deps", *(wheel_of(name, place) for name in names))
