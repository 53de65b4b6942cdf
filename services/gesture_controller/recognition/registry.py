"""The registry: recognizers by name, ours and those that other packages bring.

A package adds one with an entry point in the group `handover.recognizers`:

    [project.entry-points."handover.recognizers"]
    nearest = "my_package:make"
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from handover.errors import UsageError
from handover.messages import message, text_of
from services.gesture_controller.recognition.recognizer import Maker

GROUP = "handover.recognizers"
THRESHOLDS, PERSONAL = "thresholds", "personal"

_OURS: Mapping[str, str] = {
    THRESHOLDS: "services.gesture_controller.recognition.thresholded:ThresholdRecognizer.made_from",
    PERSONAL: "services.gesture_controller.recognition.personal:PersonalRecognizer.made_from",
}


class UnknownRecognizer(UsageError):
    """There is no recognizer of this name, or it cannot be loaded; the message says what there is."""


def recognizers() -> list[str]:
    """Return the names of all recognizers, ours first."""
    return [*_OURS, *sorted(_theirs().keys() - _OURS.keys())]


@cache
def maker_of(name: str) -> Maker:
    """Return what makes the recognizer called `name`; it is imported now, not before.

    Raises `UnknownRecognizer`.
    """
    where = _OURS.get(name)
    point = EntryPoint(name, where, GROUP) if where else _theirs().get(name)
    if point is None:
        raise UnknownRecognizer(
            message(
                "recognition.unknown",
                'there is no recognizer "{name}"; there are {known}. Another comes with a '
                "package that has an entry point in {group}",
                name=name,
                known=", ".join(recognizers()),
                group=GROUP,
            )
        )
    try:
        made: Maker = point.load()
    except Exception as error:  # a stranger's package may fail in any way when it is imported
        raise UnknownRecognizer(
            message(
                "recognition.not_loadable",
                'the recognizer "{name}" ({entry_point}) cannot be loaded: {kind}: {error}; mend or '
                "remove the package that brings it",
                name=name,
                entry_point=point.value,
                kind=type(error).__name__,
                error=text_of(error),
            )
        ) from error
    if not callable(made):
        raise UnknownRecognizer(
            message(
                "recognition.not_callable",
                'the recognizer "{name}" ({entry_point}) cannot be called; name what makes it',
                name=name,
                entry_point=point.value,
            )
        )
    return made


def _theirs() -> Mapping[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
