"""The entities that references such as `Device:glove-1` name."""

from handover.settings import Settings


def resource_id(settings: Settings, reference: str) -> str:
    """Return the URN of a reference such as `Device:glove-1`; a URN is returned unchanged."""
    if reference.startswith("urn:"):
        return reference
    kind, _, name = reference.partition(":")
    return settings.entity_id(kind, name)
