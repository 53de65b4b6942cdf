"""The subscriptions that a service has written, in a file of its data directory.

What a service no longer needs, such as the subscription of a robot that was removed, is known to nobody after
a restart, and the broker retries it for ever. The ids alone do not show which are the service's own: another
cell of the same factory may use the same broker, and have the robot now. So the file has each subscription
with the address that it notifies, from before it is written until it is deleted.
"""

from collections.abc import Collection
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from handover.broker import BrokerClient, NgsiLd, NotFound
from handover.files.durable_files import replace_durably
from handover.telemetry import get_logger

log = get_logger(__name__)

_FORM = TypeAdapter(dict[str, str])


class SubscriptionRecord:
    """The record in the file at `path`; without a file it is empty."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._written: dict[str, str] = {}
        try:
            self._written = _FORM.validate_json(path.read_bytes())
        except FileNotFoundError:
            pass
        except (OSError, ValidationError) as error:
            log.warning("record of subscriptions not read, it begins again", file=str(path), error=str(error))

    def add(self, subscription: NgsiLd) -> None:
        """Record a subscription that is about to be written."""
        self._save(self._written | {str(subscription["id"]): _address(subscription)})

    def remove(self, subscription_id: str) -> None:
        """Forget a subscription that was deleted."""
        self._save({key: value for key, value in self._written.items() if key != subscription_id})

    async def delete_others(self, broker: BrokerClient, wanted: Collection[str]) -> None:
        """Delete the recorded subscriptions that are not `wanted`. Raises `BrokerError`.

        One that notifies another address by now belongs to another service, and stays.
        """
        for subscription_id in sorted(self._written.keys() - set(wanted)):
            try:
                present = await broker.subscription(subscription_id)
                if _address(present) == self._written[subscription_id]:
                    await broker.delete_subscription(subscription_id)
                    log.info("unused subscription deleted", subscription=subscription_id)
            except NotFound:
                pass
            self.remove(subscription_id)

    def _save(self, written: dict[str, str]) -> None:
        if written == self._written:
            return
        self._written = written
        try:
            replace_durably(self._path, _FORM.dump_json(written))
        except OSError as error:
            log.warning("record of subscriptions not written", file=str(self._path), error=str(error))


def _address(subscription: NgsiLd) -> str:
    return str(subscription.get("notification", {}).get("endpoint", {}).get("uri", ""))
