"""Stored messages: messages to processes that nobody waited for yet, by name and by their expiry."""

from collections.abc import Collection, Iterable
from datetime import datetime

from handover_bpmn.timing.due_queue import DueQueue
from handover_processes.records.messages import MessageRecord


class StoredMessages:
    """The messages in the order of their sending."""

    def __init__(self, records: Iterable[MessageRecord] = ()) -> None:
        self._records: dict[str, MessageRecord] = {}
        self._by_name: dict[str, dict[str, MessageRecord]] = {}
        self._expiries = DueQueue[str]()
        for record in records:
            self.add(record)

    def add(self, record: MessageRecord) -> None:
        """Add a message."""
        self._records[record.id] = record
        self._by_name.setdefault(record.name, {})[record.id] = record
        self._expiries.set(record.id, record.expires_at)

    def remove(self, message_id: str) -> None:
        """Remove a message, if it is there."""
        record = self._records.pop(message_id, None)
        if record is None:
            return
        self._expiries.set(message_id, None)
        of_name = self._by_name[record.name]
        del of_name[message_id]
        if not of_name:
            del self._by_name[record.name]

    def named(self, names: Collection[str]) -> list[MessageRecord]:
        """Return the messages with one of these names, in the order of their sending."""
        records = [record for name in names for record in self._by_name.get(name, {}).values()]
        return sorted(records, key=lambda record: record.sent_at)

    def next_expiry(self) -> datetime | None:
        """Return when the next message expires."""
        return self._expiries.next_due()

    def expired(self, now: datetime) -> list[MessageRecord]:
        """Return the messages whose time to live is over."""
        return [self._records[message_id] for message_id in self._expiries.due(now)]
