"""The registry: recognizers by name, built-in ones and those of other packages.

A package adds one with an entry point in the group `handover.recognizers`:

    [project.entry-points."handover.recognizers"]
    nearest = "my_package:make"
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from handover.errors import UsageError
from handover.messages import message, text_of
from handover_gloves.recognition.recognizer import RecognizerFactory

GROUP = "handover.recognizers"
THRESHOLDS, PERSONAL = "thresholds", "personal"

_BUILT_IN: Mapping[str, str] = {
    THRESHOLDS: "handover_gloves.recognition.thresholded:ThresholdRecognizer.from_context",
    PERSONAL: "handover_gloves.recognition.personal:PersonalRecognizer.from_context",
}


class UnknownRecognizer(UsageError):
    """No recognizer has this name, or it cannot be loaded; the message lists the names."""


def recognizers() -> list[str]:
    """Return the names of all recognizers, built-in ones first."""
    return [*_BUILT_IN, *sorted(_of_packages().keys() - _BUILT_IN.keys())]


@cache
def factory_of(name: str) -> RecognizerFactory:
    """Import and return the factory of the recognizer called `name`; raises `UnknownRecognizer`."""
    where = _BUILT_IN.get(name)
    point = EntryPoint(name, where, GROUP) if where else _of_packages().get(name)
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
        factory: RecognizerFactory = point.load()
    except Exception as error:  # the import of another package may fail in any way
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
    if not callable(factory):
        raise UnknownRecognizer(
            message(
                "recognition.not_callable",
                'the recognizer "{name}" ({entry_point}) cannot be called; name what makes it',
                name=name,
                entry_point=point.value,
            )
        )
    return factory


def _of_packages() -> Mapping[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
