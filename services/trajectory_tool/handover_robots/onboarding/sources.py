"""Where a URDF and the meshes that it names are: files, ROS packages of ament shares, example-robot-data."""

import os
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from handover.errors import UsageError

EXAMPLES = "example-robot-data"
PACKAGE = "package://"


def find_urdf(source: str) -> Path:
    """Return the file of a path, a `package://` URL, or `example-robot-data:NAME`. Raises `UsageError`."""
    if source.startswith(f"{EXAMPLES}:"):
        return _example(source.partition(":")[2])
    if source.startswith(PACKAGE):
        file = _in_package(source, Path.cwd())
        if file is None:
            raise UsageError(
                f"{source} was not found; source the setup file of your ROS installation "
                "(AMENT_PREFIX_PATH), or give the path of the file"
            )
        return file
    return Path(source)


def find_mesh(name: str, urdf: Path) -> Path | None:
    """Return the file of a mesh that a URDF names; None if it is not there."""
    if name.startswith(PACKAGE):
        return _in_package(name, urdf.absolute().parent)
    path = Path(name.removeprefix("file://"))
    path = path if path.is_absolute() else urdf.parent / path
    return path if path.is_file() else None


def _in_package(url: str, start: Path) -> Path | None:
    package, _, rest = url.removeprefix(PACKAGE).partition("/")
    for share in _shares(package, start):
        if (share / rest).is_file():
            return share / rest
    return None


def _shares(package: str, start: Path) -> Iterator[Path]:
    """Yield where a package may be: above `start`, in ament prefixes, in paths of ROS 1, in the examples."""
    for folder in (start, *start.parents):
        if folder.name == package:
            yield folder
        yield folder / package
    for prefix in _paths("AMENT_PREFIX_PATH"):
        yield prefix / "share" / package
    for path in _paths("ROS_PACKAGE_PATH"):
        yield path if path.name == package else path / package
    if (examples := _examples_folder()) is not None:
        yield examples.parent / package


def _paths(variable: str) -> list[Path]:
    return [Path(folder) for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


def _example(name: str) -> Path:
    folder = _examples_folder()
    if folder is None:
        raise UsageError(f"{EXAMPLES} is not installed: pip install {EXAMPLES}")
    files = {path.stem: path for path in sorted(folder.glob("robots/**/*.urdf"))}
    if name not in files:
        raise UsageError(f'{EXAMPLES} has no robot "{name}"; it has {", ".join(sorted(files))}')
    return files[name]


def _examples_folder() -> Path | None:
    """Return the folder `example-robot-data` of the installed package."""
    try:
        files = distribution(EXAMPLES).files or []
    except PackageNotFoundError:
        return None
    for file in files:
        if file.suffix == ".urdf" and "robots" in file.parts:
            path = Path(str(file.locate()))
            return Path(*path.parts[: path.parts.index("robots")])
    return None
