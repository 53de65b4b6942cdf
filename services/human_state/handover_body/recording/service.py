"""The parts of recording, wired together."""

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.broker.latest_value_writer import LatestValueWriter
from handover.runtime.background_tasks import BackgroundTasks
from handover_body.exchange.deletions import Deletions
from handover_body.exchange.health_entities import HealthEntities
from handover_body.monitoring.monitoring import Monitoring
from handover_body.people.people import People
from handover_body.recording.archive import Archive
from handover_body.recording.export import RecordingExport
from handover_body.recording.recordings import Recordings
from handover_body.recording.session_entities import SessionEntities
from handover_body.recording.task_markers import TaskMarkers
from handover_body.settings import HumanStateSettings
from handover_body.storage.store import RecordingRow, Store


class RecordingService:
    """Recordings with their entities, markers from Tasks, and export."""

    def __init__(
        self,
        settings: HumanStateSettings,
        *,
        store: Store,
        people: People,
        monitoring: Monitoring,
        tasks: BackgroundTasks,
        broker: BrokerClient,
        health: HealthEntities,
        writer: LatestValueWriter,
        deletions: Deletions,
    ) -> None:
        folder, key = settings.data_dir / "recordings", settings.recording_key
        self.recordings = Recordings(
            Archive(folder, key), store, people, monitoring, tasks, settings.health_recording_days
        )
        self.entities = SessionEntities(
            settings, people, self.recordings, broker, writer, health=health, deletions=deletions
        )
        self.export = RecordingExport(folder, key)
        self._markers = TaskMarkers(settings, self.recordings, broker, writer)
        self._tasks = tasks
        self._writer = writer

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications."""
        self._markers.mount(app)

    async def open(self) -> None:
        """Begin, and close what a crash has interrupted. Raises `UsageError`."""
        self._markers.require_key()
        await self.recordings.load()
        self.recordings.on_changed = self._changed
        self.recordings.on_deleted = self.entities.deleted
        self._tasks.start(self.recordings.recover)
        self._tasks.start_restarting(self.recordings.run)
        self._tasks.start_restarting(self._markers.run)
        self._writer.put("sessions", self.entities.synchronize)
        self._markers.apply()

    def apply(self, person: str) -> None:
        """Do what a changed consent asks."""
        self.recordings.apply(person)
        self.entities.apply(person)

    async def close(self) -> None:
        """End the recordings that run."""
        await self.recordings.close()

    def _changed(self, row: RecordingRow) -> None:
        self.entities.changed(row)
        self._markers.apply()
