"""Services of other packages (the entry points of `handover.services`), to be shown beside ours."""

from collections.abc import Iterator
from dataclasses import dataclass

from handover.errors import UsageError
from handover.extensions import EXTRA_SERVICES, Service
from handover.telemetry import get_logger
from handover_web.settings import WebuiSettings

log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class ExtraService:
    """A service of another package: `url` is None, and `fault` the reason, if it cannot be loaded.

    `is_wanted` if `HANDOVER_EXTRA_SERVICES` names it: then it is a problem if it does not respond.
    """

    name: str
    url: str | None
    is_wanted: bool
    fault: str | None = None


def extra_services(settings: WebuiSettings) -> Iterator[ExtraService]:
    """Yield the services that the cell wants, and the other registered ones that can be loaded."""
    wanted = settings.extra_services
    registered = EXTRA_SERVICES.names()
    for name in (*wanted, *(one for one in registered if one not in wanted)):
        try:
            yield ExtraService(name, _url_of(name), name in wanted)
        except UsageError as fault:
            if name in wanted:
                yield ExtraService(name, None, is_wanted=True, fault=" ".join(str(fault).split()))
            else:
                log.warning("service not loaded", service=name, error=str(fault))


def _url_of(name: str) -> str:
    """Return the URL of a service: of its setting `…_url` if it has one, else its port on this machine."""
    service = EXTRA_SERVICES.load(name)
    if not isinstance(service, Service):
        raise UsageError(f'the entry point "{name}" in "{EXTRA_SERVICES.group}" is no Service')
    url_field = f"{service.port_field.removesuffix('_port')}_url"
    loaded = service.settings.load()
    return loaded.url_of(service.port(), getattr(loaded, url_field, None))
