"""REST: sensors of persons, and the drivers of sensors."""

from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from pydantic import ValidationError

from handover.errors import HandoverError, Problem
from handover.formats.validation import fault_text
from handover.http.api_description import TaggedRoutes
from handover.messages import text_of
from handover.security.guard import guard_of, require_somewhere
from handover.security.permissions import Permission
from handover_body.drivers.base import SENSOR_DRIVERS, SensorDriver
from handover_body.routes.bodies import DriverView, FoundView, Name, PersonView, SensorChange
from handover_body.routes.parts import Configurer, Parts
from handover_body.routes.views import person_view
from handover_body.storage.store import SensorRow

Seconds = Annotated[float, Query(gt=0, le=30)]


def add_sensor_routes(app: FastAPI, parts: Parts) -> None:
    """Add the routes of sensors and their drivers."""
    routes = TaggedRoutes(app, "sensors")
    people, monitoring = parts.people, parts.monitoring

    @routes.put("/sensors/{sensor}")
    async def put_sensor(
        sensor: Name,
        body: SensorChange,
        caller: Configurer,
        request: Request,
    ) -> PersonView:
        """Give a person a sensor; it runs while the person consents. Another person loses it."""
        guard = guard_of(request)
        guard.require(caller, Permission.CONFIGURE, guard.settings.entity_id("Person", body.person))
        driver = _driver(body.driver)
        settings = driver.settings_model.completed(body.settings, people.stored_settings(sensor, body.driver))
        try:
            driver.settings_model.model_validate(settings)
        except ValidationError as error:
            faults = fault_text(error, "settings")
            raise Problem(422, "Bad settings", f"the settings of {body.driver}: {faults}") from None
        row = SensorRow(sensor, body.driver, settings, body.person)
        return person_view(await people.put_sensor(row), monitoring)

    @routes.delete("/sensors/{sensor}", status_code=204)
    async def delete_sensor(
        sensor: Name,
        caller: Configurer,
        request: Request,
    ) -> Response:
        """Take a sensor away from its person."""
        guard = guard_of(request)
        person = people.sensor(sensor).person
        guard.require(caller, Permission.CONFIGURE, guard.settings.entity_id("Person", person))
        await people.remove_sensor(sensor)
        return Response(status_code=204)

    @routes.get("/drivers", dependencies=[require_somewhere(Permission.READ)])
    async def drivers() -> list[DriverView]:
        """Return the drivers of sensors, with the JSON Schema of their settings."""
        views = []
        for name in SENSOR_DRIVERS.names():
            kind = _driver(name)
            text = (kind.__doc__ or "").strip().split("\n", maxsplit=1)[0]
            views.append(
                DriverView(name=name, description=text, settings=kind.settings_model.model_json_schema())
            )
        return views

    @routes.post("/drivers/{driver}/discover", dependencies=[require_somewhere(Permission.CONFIGURE)])
    async def discover(driver: str, timeout_s: Seconds = 5.0) -> list[FoundView]:
        """Search for devices of a driver."""
        kind = _driver(driver)
        try:
            devices = await kind.discover(timeout_s)
        except (HandoverError, OSError, RuntimeError) as error:  # no adapter, or no library of the driver
            raise Problem.translated(
                409,
                "Cannot search",
                "health.cannot_search",
                "{driver} cannot search here: {why}",
                driver=driver,
                why=text_of(error),
            ) from error
        return [
            FoundView(address=device.address, name=device.name, rssi_dbm=device.rssi_dbm)
            for device in devices[:200]
        ]


def _driver(name: str) -> type[SensorDriver]:
    try:
        driver: type[SensorDriver] = SENSOR_DRIVERS.load(name)
    except HandoverError as error:
        raise Problem(422, "Unknown driver", str(error)) from None
    return driver
