"""The distribution that these packages are installed by, and how to install what it can have beside them.

The name `handover` on the package index belongs to others, so that no text of ours may install it, and ours
is not there yet: pip finds our wheels in the folder that `--find-links` names (`make dist`).
"""

from importlib.metadata import version as version_of
from typing import Final

DISTRIBUTION: Final = "handover-cell"
KIT: Final = "handover-kit"
"""A part of every installation; all distributions have one version."""


def install_part(distribution: str) -> str:
    """Return the command that installs one of our distributions; `dist` is the folder of our wheels."""
    return f"pip install --find-links dist {distribution}"


def install_command(*extras: str) -> str:
    """Return the command that installs the distribution of a cell with `extras`."""
    return install_part(f'"{DISTRIBUTION}[{",".join(extras)}]"')


def version() -> str:
    """Return the version of all distributions; raise `PackageNotFoundError` where none is installed."""
    return version_of(KIT)
