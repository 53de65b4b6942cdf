"""Extension points: robots, exporters and services by name, ours and those of other installed packages.

A package registers what it adds with an entry point, and nothing else in the tree knows its name:

    [project.entry-points."handover.exporters"]
    xes = "xes_exporter:export"

`docs/how-to/extend.md` describes each group. Recognizers and glove sources have registries of their own.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from handover.distribution import install_part
from handover.errors import UsageError
from handover.settings import Settings

if TYPE_CHECKING:
    from fastapi import FastAPI


class UnknownExtension(UsageError):
    """Nothing is registered under this name, or it cannot be imported; the message says what there is."""


@dataclass(frozen=True, slots=True)
class ExtensionPoint:
    """The things of one `kind`: `own` are those of ours that no package registers, as `module:attribute`.

    `parts` are those that a distribution of ours registers, which need not be installed, by their names.
    """

    kind: str
    group: str
    own: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Return all names, ours first."""
        return [*self.own, *sorted(self._registered().keys() - self.own.keys())]

    def load(self, name: str) -> Any:
        """Return what is registered as `name`, imported now.

        Raises `UnknownExtension`, and `UsageError` if two packages use the name.
        """
        return self._load(name, self._registered())

    def load_registered(self, names: Iterable[str]) -> list[Any]:
        """Return those of `names` that are registered, as `load` does; installed packages are read once."""
        registered = self._registered()
        return [self._load(name, registered) for name in names if name in registered]

    def _load(self, name: str, registered: Mapping[str, Sequence[EntryPoint]]) -> Any:
        own = self.own.get(name)
        points = (EntryPoint(name, own, self.group),) if own else registered.get(name, ())
        if not points and name in self.parts:
            raise UnknownExtension(
                f'the {self.kind} "{name}" is not installed; install it: {install_part(self.parts[name])}'
            )
        if not points:
            raise UnknownExtension(
                f'there is no {self.kind} "{name}"; there are: {", ".join(self.names()) or "none"}. '
                f'A package adds one with an entry point in "{self.group}"'
            )
        if len(points) > 1:
            raise UsageError(
                f'two packages register the {self.kind} "{name}": {_owner(points[0])} and '
                f"{_owner(points[1])}; remove one of them"
            )
        try:
            return points[0].load()
        except Exception as error:  # a package of somebody else may fail in any way when it is imported
            raise UnknownExtension(
                f'the {self.kind} "{name}" ({points[0].value}) cannot be loaded: {type(error).__name__}: '
                f"{error}; repair or remove the package that registers it"
            ) from error

    def _registered(self) -> Mapping[str, Sequence[EntryPoint]]:
        """Return what packages register: several entry points where packages use one name."""
        points: dict[str, dict[str, EntryPoint]] = {}
        for point in entry_points(group=self.group):
            points.setdefault(point.name, {}).setdefault(point.value, point)
        return {name: list(by_value.values()) for name, by_value in points.items()}


def _owner(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "an unknown package"


@dataclass(frozen=True, slots=True)
class Service:
    """One service: `python -m module` runs it; `port_field` is the setting of its HTTP port.

    `also_listens` are more places where it listens: the settings of the host and the port. `handover up`
    starts it if the packages `needs` can be imported and `runs_if`, where given, returns true: it says
    whether the settings give the service anything to do.
    """

    name: str
    module: str
    settings: type[Settings]
    port_field: str
    also_listens: tuple[tuple[str, str], ...] = ()
    needs: tuple[str, ...] = ()
    runs_if: Callable[[], bool] | None = None

    @property
    def port_setting(self) -> str:
        """Return the name of the environment variable that sets the port."""
        return f"HANDOVER_{self.port_field.upper()}"

    def port(self) -> int:
        """Return the port it listens on."""
        return int(getattr(self.settings.load(), self.port_field))

    def listens(self) -> Iterator[tuple[str, int, str]]:
        """Yield every host and port it listens on, with the environment variable that sets the port."""
        loaded = self.settings.load()
        for host_field, port_field in (("host", self.port_field), *self.also_listens):
            host, port = getattr(loaded, host_field), getattr(loaded, port_field)
            yield str(host), int(port), f"HANDOVER_{port_field.upper()}"

    def url(self) -> str:
        """Return where it answers on this machine."""
        return self.settings.load().url_of(self.port())

    def is_useful(self) -> bool:
        """Return whether `handover up` starts the service."""
        return all(map(find_spec, self.needs)) and (self.runs_if is None or self.runs_if())


SERVICES = ExtensionPoint(
    "service",
    "handover.services",
    parts={
        "accounts": "handover-accounts",
        "alert-router": "handover-alerts",
        "assistive-devices": "handover-cases",
        "context-broker": "handover-broker",
        "device-gateway": "handover-devices",
        "gesture-controller": "handover-gloves",
        "human-state": "handover-body",
        "ros-bridge": "handover-ros",
        "study": "handover-study",
        "task-orchestrator": "handover-processes",
        "trajectory-tool": "handover-robots",
        "webui": "handover-web",
        "whole-body-control": "handover-humanoid",
    },
)
"""The services that are installed, ours and those of other packages; each entry point is a `Service`."""


def load_service(name: str) -> Service:
    """Return the service that is registered as `name`. Raises `UsageError`."""
    service = SERVICES.load(name)
    if not isinstance(service, Service):
        raise UsageError(
            f'the entry point "{name}" in "{SERVICES.group}" is no handover.extensions.Service; '
            "correct it in the package that registers it"
        )
    return service


def application_of(service: Service) -> "FastAPI | None":
    """Return the application of a service with the present settings; None if FastAPI does not answer it."""
    from fastapi import FastAPI  # noqa: PLC0415 - the command line starts without it

    for module in ("app", "server"):
        try:
            make = getattr(importlib.import_module(f"{service.module}.{module}"), "make_app", None)
        except ModuleNotFoundError:
            continue
        if make is not None:
            made: Any = make(service.settings.load())
            while not isinstance(made, FastAPI):  # a wrapper of the application
                made = next(value for name, value in vars(made).items() if name.lstrip("_") == "app")
            return made
    return None
