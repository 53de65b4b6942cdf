"""The parts of recording, wired together."""

from fastapi import FastAPI

from handover.background_tasks import BackgroundTasks
from handover.broker import BrokerClient
from handover.latest_value_writer import LatestValueWriter
from services.human_state.exchange.deletions import Deletions
from services.human_state.exchange.health_entities import HealthEntities
from services.human_state.monitoring.monitoring import Monitoring
from services.human_state.people.people import People
from services.human_state.recording.archive import Archive
from services.human_state.recording.export import RecordingExport
from services.human_state.recording.recordings import Recordings
from services.human_state.recording.session_entities import SessionEntities
from services.human_state.recording.task_markers import TaskMarkers
from services.human_state.settings import HumanStateSettings
from services.human_state.storage.store import RecordingRow, Store


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
