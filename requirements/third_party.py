"""Writes THIRD_PARTY.md: the licences of everything that a running Handover consists of.

    python -m requirements.third_party            # write the file
    python -m requirements.third_party --check    # fail if the file is not up to date

The names come from the locks (`handover.lock`, `package-lock.json`), the licences from the metadata of the
installed packages. Versions are left out, because the locks have them.
Both commands fail on a package with a licence that Apache-2.0 software cannot be distributed with (GPL),
and on a package without a licence.
"""

import argparse
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from requirements.subset import subset

ROOT = Path(__file__).parent.parent
FILE = ROOT / "THIRD_PARTY.md"
DISTRIBUTIONS = ("handover-cell[all]", "handover-glove-sdk-bridge[serial]")
"""What an installation may have, without what is for figures and models of research alone."""
APP = ROOT / "webui" / "app"

SPDX = {
    "bsd 3-clause license": "BSD-3-Clause",
    "apache 2.0": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "bsd": "BSD-3-Clause",
    "bsd license": "BSD-3-Clause",
    "epl-2.0, bsd-3-clause": "EPL-2.0 OR BSD-3-Clause",
    "gnu library or lesser general public license (lgpl)": "LGPL-3.0-or-later",
    "isc license": "ISC",
    "isc license (iscl)": "ISC",
    "lgplv3": "LGPL-3.0-or-later",
    "mit license": "MIT",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
}
"""Spellings of licences in metadata that has no SPDX expression."""

KNOWN = {
    "skops": "MIT",
    "winrt-windows-storage-streams": "MIT",  # macOS and Windows only
    "winrt-windows-foundation-collections": "MIT",  # macOS and Windows only
    "winrt-windows-foundation": "MIT",  # macOS and Windows only
    "winrt-windows-devices-radios": "MIT",  # macOS and Windows only
    "winrt-windows-devices-enumeration": "MIT",  # macOS and Windows only
    "winrt-windows-devices-bluetooth-genericattributeprofile": "MIT",  # macOS and Windows only
    "winrt-windows-devices-bluetooth-advertisement": "MIT",  # macOS and Windows only
    "winrt-windows-devices-bluetooth": "MIT",  # macOS and Windows only
    "winrt-runtime": "MIT",  # macOS and Windows only
    "pyobjc-framework-libdispatch": "MIT",  # macOS and Windows only
    "pyobjc-framework-corebluetooth": "MIT",  # macOS and Windows only
    "pyobjc-framework-cocoa": "MIT",  # macOS and Windows only
    "pyobjc-core": "MIT",  # macOS and Windows only
    "brainflow": "MIT",
    "colorama": "BSD-3-Clause",  # Windows only
    "tzdata": "Apache-2.0",  # Windows only
    "cmeel-qhull": "Qhull",
    "fastapi-offline": "MIT AND Apache-2.0",  # with Swagger UI in it
    "scipy": "BSD-3-Clause",  # its metadata has the text of the licence
    "bpmn-js": "bpmn.io licence (MIT, and its mark in a diagram stays visible)",
    "diagram-js": "MIT",
}
"""Licences that the metadata does not name, or of packages that are not installed on Linux."""

INTRODUCTION = """\
# Software of others

Written by `make third-party`; do not edit. Versions are in `requirements/` and `webui/app/package-lock.json`.

## Python packages

They are installed from their own packages; those that only an extra such as `body`, `motion` or `ros` needs,
with that extra. The extra `ros-rclpy` also installs wheels of ROS 2, which have their licences (Apache-2.0,
BSD-3-Clause) in their own metadata. Packages under the LGPL are used unmodified and can be replaced.

"""
PAGE_INTRODUCTION = """
## npm packages

Parts of them are in the page that the wheel and the container contain.

"""

REFUSED = re.compile(r"(?<!L)(?:A?GPL|SSPL|BUSL|GNU (Affero )?General Public|Commons Clause)", re.IGNORECASE)
FOR_DEVELOPMENT = {"dev", "devOptional", "peer"}
"""Marks in package-lock.json of packages that are no part of the page."""

LICENCE_FILE = re.compile(r"(licen[cs]e|copying|notice)", re.IGNORECASE)
MAX_NAME_LENGTH = 60
"""A longer licence in the metadata is its text, not its name."""


class LicenceError(Exception):
    """A licence is unknown or refused; the message names the package and the way out."""


@dataclass(frozen=True, slots=True)
class Package:
    """One package that is installed with Handover, or whose code is a part of the page."""

    name: str
    licence: str
    url: str
    texts: tuple[str, ...] = ()


def main(arguments: Sequence[str] | None = None) -> None:
    """Write or check THIRD_PARTY.md."""
    parser = argparse.ArgumentParser(prog="python -m requirements.third_party", description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail if THIRD_PARTY.md is not up to date")
    options = parser.parse_args(arguments)
    try:
        text = document(list(python_packages()), list(page_packages()))
    except LicenceError as error:
        raise SystemExit(f"third_party: {error}") from None
    if not options.check:
        FILE.write_text(text, encoding="utf-8")
    elif not FILE.exists() or FILE.read_text(encoding="utf-8") != text:
        raise SystemExit("THIRD_PARTY.md is not up to date; write it with: make third-party")


def python_packages() -> Iterator[Package]:
    """Yield the Python packages of the locks; raise `LicenceError`."""
    names = {
        re.split(r"\[|==", line)[0]
        for line in subset(DISTRIBUTIONS).splitlines()
        if re.match(r"[a-z0-9][\w.\[\]-]*==", line)
    }
    for name in sorted(names):
        url = f"https://pypi.org/project/{name}/"
        yield Package(name, accepted(name, KNOWN.get(name) or _licence_of(name)), url)


def page_packages() -> Iterator[Package]:
    """Yield the npm packages whose code may be a part of the page; raise `LicenceError`."""
    lock = json.loads((APP / "package-lock.json").read_text(encoding="utf-8"))
    for path, locked in sorted(lock["packages"].items()):
        if not path or not FOR_DEVELOPMENT.isdisjoint(locked) or path.startswith("node_modules/@types/"):
            continue
        folder = APP / path
        manifest = folder / "package.json"
        if not manifest.exists():
            if locked.get("optional"):
                continue
            raise LicenceError(f"{path} is not installed; install it with: python -m handover_web.build")
        name = path.rpartition("node_modules/")[2]
        licence = KNOWN.get(name) or str(json.loads(manifest.read_text(encoding="utf-8")).get("license", ""))
        texts = tuple(
            file.read_text(encoding="utf-8", errors="replace").strip()
            for file in sorted(folder.iterdir())
            if file.is_file() and LICENCE_FILE.match(file.name)
        )
        yield Package(name, accepted(name, licence), f"https://www.npmjs.com/package/{name}", texts)


def accepted(name: str, licence: str) -> str:
    """Return `licence` if Handover can be distributed with a package under it; raise `LicenceError`."""
    choices = [choice for choice in re.split(r"\bOR\b", licence) if not REFUSED.search(choice)]
    if not licence:
        raise LicenceError(f'the metadata of "{name}" names no licence; add it to KNOWN in {__file__}')
    if not choices:
        raise LicenceError(
            f'"{name}" has the licence {licence}, which cannot be combined with Apache-2.0; '
            "use another package"
        )
    return licence


def document(python: Sequence[Package], page: Sequence[Package]) -> str:
    """Return the text of THIRD_PARTY.md."""
    lines = [*INTRODUCTION.splitlines(), *_table(python), *PAGE_INTRODUCTION.splitlines(), *_table(page)]
    lines += ["", "## Licence texts of the npm packages"]
    names_by_text: dict[str, list[str]] = {}
    for package in page:
        for text in package.texts:
            names_by_text.setdefault(text, []).append(package.name)
    for text, names in names_by_text.items():
        lines += ["", f"### {', '.join(names)}", "", "```text"]
        lines += [line.rstrip() for line in text.splitlines()]
        lines.append("```")
    return "\n".join(lines) + "\n"


def _table(packages: Sequence[Package]) -> Iterator[str]:
    yield "| Package | Licence |"
    yield "|---|---|"
    for package in packages:
        yield f"| [{package.name}]({package.url}) | {package.licence} |"


def _licence_of(name: str) -> str:
    try:
        fields = metadata(name)
    except PackageNotFoundError:
        raise LicenceError(f'"{name}" is not installed; install it with: make setup') from None
    if "License-Expression" in fields:
        return fields["License-Expression"]
    named = str((fields.get_all("License") or [""])[0]).strip().partition("\n")[0].strip()
    if named and len(named) <= MAX_NAME_LENGTH and "(" not in named:
        return SPDX.get(named.lower(), named)
    classifiers = [
        line.rpartition("::")[2].strip()
        for line in fields.get_all("Classifier") or []
        if line.startswith("License ::")
    ]
    return " OR ".join(SPDX.get(one.lower(), one) for one in classifiers)


if __name__ == "__main__":
    main()
