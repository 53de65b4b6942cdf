"""A compose override: the containers of a cell with security files in folders of this machine.

`docker-compose.yml` keeps them in the volumes of its init container. With an override they are in folders, so
that the authority can be that of the site, and the command line of this machine is a client of the cell.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from handover.errors import UsageError
from handover.files.durable_files import replace_durably

INIT: Final = "init"
OVERRIDE_FILE: Final = "docker-compose.override.yml"
USER_OF_IMAGE: Final = 10001
_VARIABLE: Final = re.compile(r"\$\{([A-Z_]+)(?::-([^}]*))?\}")

Make = Callable[[Sequence[str], Mapping[str, str]], None]
"""Makes what the init container makes, by its arguments and environment."""


def write_override(compose: Path, data_dir: Path, names: Sequence[str], make: Make) -> None:
    """Make the files of the containers in `data_dir`, and the override beside `compose`.

    `names` are the host names of the cell. Raises `UsageError`.
    """
    services = _services(compose)
    folders = {
        target: (data_dir / "cell" / volume).absolute() for volume, target, _ in _mounts(services[INIT])
    }
    words = [_with_names(str(word), names) for word in services[INIT]["command"]]
    make(
        [_on_this_machine(word, folders) for word in words],
        {
            name: _on_this_machine(str(value), folders)
            for name, value in services[INIT]["environment"].items()
        },
    )
    override = {"services": _overridden(services, folders, words, names)}
    file = compose.parent / OVERRIDE_FILE
    comment = "# Made by `handover secure --compose`.\n"
    replace_durably(file, (comment + yaml.safe_dump(override, sort_keys=False)).encode(), mode=0o644)
    print(f"override: {file.absolute()}")
    root = data_dir.absolute() / "cell"
    if os.getuid() == 0:
        _give_to_the_image(root)
    else:
        print(f"The containers run as another user: sudo chown -R {USER_OF_IMAGE}:{USER_OF_IMAGE} {root}")


def _services(compose: Path) -> dict[str, Any]:
    try:
        read = yaml.safe_load(compose.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"the compose file {compose} cannot be read: {error}") from None
    services = read.get("services") if isinstance(read, dict) else None
    if not isinstance(services, dict) or INIT not in services:
        raise UsageError(
            f'{compose} has no service "{INIT}"; name the docker-compose.yml of Handover with --compose'
        )
    return services


def _mounts(service: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return volume, target and mode of the named volumes of a service."""
    parts = (str(mount).split(":") for mount in service.get("volumes", ()))
    return [(part[0], part[1], ":".join(part[2:])) for part in parts if not part[0].startswith((".", "/"))]


def _overridden(
    services: Mapping[str, Any], folders: Mapping[str, Path], words: Sequence[str], names: Sequence[str]
) -> dict[str, Any]:
    of_init = {volume: folders[target] for volume, target, _ in _mounts(services[INIT])}
    overridden: dict[str, Any] = {}
    for name, service in services.items():
        mounts = [
            f"{of_init[volume]}:{target}" + (f":{mode}" if mode else "")
            for volume, target, mode in _mounts(service)
            if volume in of_init
        ]
        changed: dict[str, Any] = {"volumes": mounts} if mounts else {}
        if names and "HANDOVER_ALLOWED_HOSTS" in service.get("environment", {}):
            changed["environment"] = {"HANDOVER_ALLOWED_HOSTS": ",".join(names)}
        if name == INIT:
            changed["command"] = list(words)
        if changed:
            overridden[name] = changed
    return overridden


def _with_names(word: str, names: Sequence[str]) -> str:
    """Return an argument of the init container with the names of the cell instead of its variables."""
    if not _VARIABLE.search(word):
        return word
    plain = _VARIABLE.sub("", word).rstrip(",").replace(",,", ",")
    return ",".join((plain, *names))


def _on_this_machine(text: str, folders: Mapping[str, Path]) -> str:
    """Return an argument or a path of the container with the folder of this machine instead."""
    option, equals, value = text.partition("=") if text.startswith("--") else ("", "", text)
    target, separator, rest = value.partition("=")
    folder = folders.get(target)
    return text if folder is None else f"{option}{equals}{folder}{separator}{rest}"


def _give_to_the_image(root: Path) -> None:
    for folder, _, files in os.walk(root):
        os.chown(folder, USER_OF_IMAGE, USER_OF_IMAGE)
        for file in files:
            os.chown(Path(folder) / file, USER_OF_IMAGE, USER_OF_IMAGE)
