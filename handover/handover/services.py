"""The services of a cell: those that are installed, and those of them that `handover up` starts."""

import json
import os
from collections.abc import Iterator
from hashlib import sha256

from handover.errors import UsageError
from handover.extensions import SERVICES, Service, load_service
from handover.service_addresses import BROKER, OWN_SERVICES
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_datamodels.contexts import handover_context

log = get_logger(__name__)


def own_services() -> tuple[Service, ...]:
    """Return those of our services that are installed."""
    return tuple(SERVICES.load_registered(OWN_SERVICES))


def all_services() -> tuple[Service, ...]:
    """Return every service that can be run, those of other packages too."""
    return (*own_services(), *map(load_service, _names_of_others()))


def wanted_services() -> tuple[Service, ...]:
    """Return the services that `handover up` starts: ours that have something to do, and those of others."""
    own = (service for service in own_services() if service.is_useful())
    named = Settings.load().extra_services
    return (*own, *(_loadable_services_of_others() if named is None else map(load_service, named)))


def service_named(name: str) -> Service:
    """Return the service called `name`; raise `UsageError` with the names there are, or what to install."""
    names = (*(name for name in OWN_SERVICES if name in SERVICES.names()), *_names_of_others())
    if name not in names and name not in SERVICES.parts:
        raise UsageError(f'there is no service "{name}"; the services are {", ".join(names)}')
    return load_service(name)


def has_own_broker() -> bool:
    """Return whether the broker of the settings is the embedded one."""
    return BROKER in SERVICES.names() and load_service(BROKER).is_useful()


def let_broker_fetch_context() -> None:
    """Name the @context of our orchestrator to another broker, unless a setting says which one.

    Our own broker has the @context of the default address. Others may keep for ever what they have fetched,
    so the address differs with the content.
    """
    settings = Settings.load()
    if not has_own_broker() and "context_url" not in settings.model_fields_set:
        digest = sha256(json.dumps(handover_context()).encode()).hexdigest()[:12]
        os.environ["HANDOVER_CONTEXT_URL"] = f"{settings.orchestrator}/context.jsonld?{digest}"


def _loadable_services_of_others() -> Iterator[Service]:
    """Yield the installed services of others; a package that is broken does not stop the cell."""
    for name in _names_of_others():
        try:
            service = load_service(name)
        except UsageError as fault:
            log.warning("service not loaded", service=name, error=str(fault))
            continue
        if service.is_useful():
            yield service


def _names_of_others() -> tuple[str, ...]:
    return tuple(name for name in SERVICES.names() if name not in OWN_SERVICES)
