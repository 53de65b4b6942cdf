"""Services of other packages (the entry points of `handover.services`), to be shown beside ours."""

from collections.abc import Iterator
from dataclasses import dataclass

from handover.errors import UsageError
from handover.extensions import SERVICES, load_service
from handover.service_addresses import OWN_SERVICES
from handover.telemetry import get_logger
from handover_web.settings import WebuiSettings

log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class ExtraService:
    """A service of another package: `url` is None, and `fault` the reason, if it cannot be loaded.

    `is_wanted` if `HANDOVER_EXTRA_SERVICES` names it or is absent: it is a problem then if it does not
    respond.
    """

    name: str
    url: str | None
    is_wanted: bool
    fault: str | None = None


def extra_services(settings: WebuiSettings) -> Iterator[ExtraService]:
    """Yield the services that the cell wants, and the other registered ones that can be loaded."""
    registered = [name for name in SERVICES.names() if name not in OWN_SERVICES]
    named = settings.extra_services or ()
    for name in (*named, *(name for name in registered if name not in named)):
        try:
            yield ExtraService(name, _url_of(name), settings.extra_services is None or name in named)
        except UsageError as fault:
            if name in named:
                yield ExtraService(name, None, is_wanted=True, fault=" ".join(str(fault).split()))
            else:
                log.warning("service not loaded", service=name, error=str(fault))


def _url_of(name: str) -> str:
    """Return the URL of a service: of its setting `…_url` if it has one, else its port on this machine."""
    service = load_service(name)
    url_field = f"{service.port_field.removesuffix('_port')}_url"
    loaded = service.settings.load()
    return loaded.url_of(service.port(), getattr(loaded, url_field, None))
