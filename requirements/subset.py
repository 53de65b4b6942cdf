"""Prints the part of `handover.lock` that some of our distributions need, with versions and hashes.

    python -m requirements.subset handover-broker >broker.txt                # an image of the broker
    python -m requirements.subset "handover-cell[all,figures]" --group dev   # everything, to develop

One lock holds for all: each distribution names what it needs in its `pyproject.toml`, the lock says in its
comments (`# via`) what needs what in turn. Only the standard library is used, since nothing is installed yet.
"""

import argparse
import functools
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parent.parent
LOCK: Final = ROOT / "requirements" / "handover.lock"
_NAME: Final = re.compile(r"([A-Za-z0-9._-]+)(?:\[([^]]*)\])?")
_VIA: Final = re.compile(r"# +(?:via )?([a-z0-9-]+)(?: \(.*\))?$")


def subset(distributions: Iterable[str], groups: Iterable[str] = (), lock: Path = LOCK) -> str:
    """Return the requirements of our `distributions`, with extras in brackets, and of dependency groups.

    Raises `ValueError` for a name that is none of ours, or for a dependency that the lock lacks.
    """
    ours, packages, needs = members(), _packages(lock), defaultdict[str, set[str]](set)
    for package, text in packages.items():
        for line in text.splitlines():
            if via := _VIA.search(line.strip()):
                needs[via[1]].add(package)
    of_groups = (name for group in groups for name in ours["handover-cell"]["dependency-groups"][group])
    wanted, chosen = _closure([*distributions, *of_groups], ours) - ours.keys(), set[str]()
    while wanted:
        name = wanted.pop()
        if name not in packages:
            raise ValueError(
                f"{name} is none of our distributions, and not in {lock.name}; a new dependency gets there "
                "by make lock"
            )
        if name not in chosen:
            chosen.add(name)
            wanted |= needs[name]
    return "".join(packages[name] for name in sorted(chosen))


def members_of(distributions: Iterable[str]) -> list[str]:
    """Return the folders of our `distributions` and of those of ours that they need."""
    ours = members()
    return sorted(ours[name]["folder"] for name in _closure(distributions, ours) & ours.keys())


def _closure(requirements: Iterable[str], ours: dict[str, dict[str, Any]]) -> set[str]:
    """Return the names of `requirements`, and of what those of them that are ours need, in turn."""
    wanted, seen = [*requirements], set[str]()
    while wanted:
        requirement = wanted.pop()
        name, extras = _parsed(requirement)
        if requirement not in seen and name in ours:
            project = ours[name]["project"]
            wanted += project.get("dependencies", [])
            wanted += (needed for extra in extras for needed in _extra(project, extra))
        seen.add(requirement)
    return {_parsed(requirement)[0] for requirement in seen}


def _extra(project: dict[str, Any], extra: str) -> list[str]:
    extras: dict[str, list[str]] = project.get("optional-dependencies", {})
    if extra not in extras:
        raise ValueError(f"{project['name']} has no extra {extra}; it has {', '.join(extras) or 'none'}")
    return extras[extra]


@functools.cache
def members() -> dict[str, dict[str, Any]]:
    """Return the `pyproject.toml` of each member by the name of its distribution, and its folder."""
    root = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    ours = {root["project"]["name"]: {**root, "folder": "."}}
    for pattern in root["tool"]["uv"]["workspace"]["members"]:
        for file in sorted(ROOT.glob(f"{pattern}/pyproject.toml")):
            member = tomllib.loads(file.read_text(encoding="utf-8"))
            ours[member["project"]["name"]] = {**member, "folder": str(file.parent.relative_to(ROOT))}
    return ours


def _packages(lock: Path) -> dict[str, str]:
    """Return the lines of each package in a lock: several blocks if its version depends on the platform."""
    packages = defaultdict[str, str](str)
    name = ""
    for line in lock.read_text(encoding="utf-8").splitlines(keepends=True):
        if line[0].isalnum():
            name = _parsed(line)[0]
        if line[0] in "#\n":
            name = ""
        if name:
            packages[name] += line
    return packages


def _parsed(requirement: str) -> tuple[str, list[str]]:
    """Return the normalised name and the extras of a requirement."""
    match = _NAME.match(requirement)
    if match is None:
        raise ValueError(f"{requirement} is no requirement")
    extras = [extra.strip() for extra in (match[2] or "").split(",") if extra.strip()]
    return re.sub(r"[-_.]+", "-", match[1]).lower(), extras


def _lines(options: argparse.Namespace) -> Iterator[str]:
    if options.folders:
        yield from (f"{folder}\n" for folder in members_of(options.distribution))
    else:
        yield subset(options.distribution, options.group)


def main(words: Sequence[str]) -> int:
    """Print the requirements; return 2 for a name that is not known."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("distribution", nargs="+", help="one of ours, such as handover-broker")
    parser.add_argument("--group", action="append", default=[], help="a dependency group of pyproject.toml")
    parser.add_argument("--folders", action="store_true", help="print the folders of our packages instead")
    try:
        sys.stdout.writelines(_lines(parser.parse_args(words)))
    except (KeyError, ValueError) as error:
        sys.stderr.write(f"requirements.subset: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
