"""Times of NGSI-LD: ISO 8601 in UTC with a `Z`.

A parsed time keeps its text, so that an entity that is passed on does not change.
"""

from datetime import UTC, datetime
from typing import Any, Literal, Self


class Timestamp(datetime):
    """An aware datetime that keeps the text from which it was parsed."""

    text: str | None = None

    @classmethod
    def read(cls, text: str) -> Self:
        """Return the time `text`; raise ValueError unless it is ISO 8601 with a time zone."""
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError(
                f'"{text}" is not a time; write it in ISO 8601 like 2026-01-31T08:30:00Z'
            ) from None
        if moment.tzinfo is None:
            raise ValueError(f'"{text}" has no time zone; write UTC with a Z like 2026-01-31T08:30:00Z')
        clock = moment.timetz()
        read = cls.combine(moment.date(), clock)
        read.text = text
        return read

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Copy and pickle with the text."""
        return (Timestamp.read, (self.text,)) if self.text is not None else super().__reduce_ex__(protocol)


def parse(text: str) -> Timestamp:
    """Return the time `text`; raise ValueError unless it is ISO 8601 with a time zone."""
    return Timestamp.read(text)


def iso(moment: datetime, timespec: Literal["microseconds", "milliseconds"] = "microseconds") -> str:
    """Return `moment` in UTC with a `Z`, with six (or three) decimals, so that the texts sort by time.

    Raises ValueError if it has no time zone.
    """
    if moment.tzinfo is None:
        raise ValueError(f"{moment.isoformat()} has no time zone; give one, such as datetime.now(UTC)")
    return moment.astimezone(UTC).replace(tzinfo=None).isoformat(timespec=timespec) + "Z"


def as_written(moment: datetime) -> str:
    """Return the text from which `moment` was parsed, otherwise its `iso` form."""
    text = moment.text if isinstance(moment, Timestamp) else None
    return text if text is not None else iso(moment)
