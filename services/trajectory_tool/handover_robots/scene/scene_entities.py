"""The scene in the broker: an Asset for each thing, and a Location for each place and zone.

The Asset `scene` has name, digest and revision of the scene. An entity of a thing that left the scene is
deleted.
"""

from collections.abc import Iterator
from typing import Any, Self

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.files.content_digest import with_digest
from handover.settings import Settings
from handover_robots.metrics import SCENE_WRITES_REJECTED
from handover_robots.scene.scene import Scene

SCENE = "scene"


class SceneEntities:
    """Keeps the entities of the scene current; an asynchronous context manager while it writes."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._settings = settings
        self._broker = broker
        self._written: set[str] = set()
        self._writer = reporting_writer("trajectory-tool", settings, broker, SCENE_WRITES_REJECTED)

    async def __aenter__(self) -> Self:
        await self._writer.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._writer.__aexit__()

    def put(self, scene: Scene, revision: int) -> None:
        """Write the scene in the background."""
        entities = {entity["id"]: with_digest(entity) for entity in self._entities(scene, revision)}
        for entity_id, entity in entities.items():
            self._writer.put(entity_id, lambda entity=entity: self._broker.upsert([entity]))  # type: ignore[misc]
        for gone in self._written - entities.keys():
            self._writer.put(gone, lambda gone=gone: self._broker.delete_batch([gone]))  # type: ignore[misc]
        self._written = set(entities)

    def _entities(self, scene: Scene, revision: int) -> Iterator[dict[str, Any]]:
        version = {"scene": scene.name, "digest": scene.digest, "revision": revision}
        cell = self._settings.entity_id("Location", "cell")
        yield self._asset(SCENE, f"The scene of {scene.name}", version)
        yield {"id": cell, "type": "Location", "name": {"type": "Property", "value": scene.name}}
        for kind, things in things_of(scene).items():
            for name, written in things.items():
                yield self._asset(name, f"{kind} {name} of {scene.name}", {"kind": kind, **written})
        for name in (*scene.bins, *scene.fixtures, *scene.zones):
            yield {
                "id": self._settings.entity_id("Location", name),
                "type": "Location",
                "name": {"type": "Property", "value": name},
                "isPartOf": {"type": "Relationship", "object": cell},
            }

    def _asset(self, name: str, description: str, state: dict[str, Any]) -> dict[str, Any]:
        return {
            "id": self._settings.entity_id("Asset", name),
            "type": "Asset",
            "description": {"type": "Property", "value": description},
            "state": {"type": "Property", "value": state},
        }


def things_of(scene: Scene) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the things of a scene as JSON, by kind and name."""
    written = scene.model_dump(mode="json", exclude_none=True)
    return {
        kind: written[plural]
        for kind, plural in (
            ("bin", "bins"),
            ("fixture", "fixtures"),
            ("obstacle", "obstacles"),
            ("fence", "fences"),
            ("camera", "cameras"),
            ("zone", "zones"),
            ("sensor", "people_sensors"),
        )
    }
