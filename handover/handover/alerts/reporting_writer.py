"""The writer of a service: it counts what the broker rejects, and raises an Alert where the broker failed."""

from prometheus_client import Counter

from handover.alerts import raise_alert
from handover.alerts.catalogue import WRITE_FAILED
from handover.broker import MAX_FAULTS, BrokerClient, BrokerError, BrokerFault
from handover.broker.latest_value_writer import LatestValueWriter
from handover.settings import Settings


def reporting_writer(
    service: str, settings: Settings, broker: BrokerClient, rejected: Counter | None = None
) -> LatestValueWriter:
    """Return the writer of a service, whose rejected writes are counted by `rejected`."""
    alert = f"{service} write failed"

    def reject(key: str, error: BrokerError | ValueError) -> None:
        if rejected is not None:
            rejected.inc()
        if isinstance(error, BrokerFault) and key != alert:
            writer.put(alert, lambda: report(key, error))

    async def report(key: str, error: BrokerFault) -> None:
        await raise_alert(
            broker,
            settings,
            WRITE_FAILED,
            key=alert,
            source=settings.entity_id("Device", service),
            description=WRITE_FAILED.describe(
                "alert.write_failed",
                times=str(MAX_FAULTS),
                key=key,
                why=str(error),
            ),
        )

    writer = LatestValueWriter(on_rejected=reject)
    return writer
