"""What analyses a signal: the pipelines of `processing`, and values that devices compute."""

from collections.abc import Collection
from typing import Final

from handover_body.model.signals import SignalInfo, SignalKind
from handover_body.monitoring.device_values import VALUES, DeviceValues
from handover_body.processing.pipeline import SignalPipeline, pipeline_for

BETTER: Final = {
    SignalKind.HEART_RATE: frozenset({SignalKind.ECG}),
    SignalKind.GAZE: frozenset({SignalKind.FIXATION, SignalKind.SACCADE}),
    SignalKind.EOG: frozenset({SignalKind.BLINK}),
}
"""Signals from which the same features follow. One sensor has one of both: two series would mix."""


def pipeline_of(info: SignalInfo, kinds: Collection[SignalKind]) -> SignalPipeline:
    """Return the processors of a signal of a sensor that sends `kinds`.

    The heart rate of a device that sends an ECG is not used as well, and so on (`BETTER`). Raises
    `ValueError` for a signal that cannot be analysed, an ECG of 10 Hz for example.
    """
    is_doubled = not BETTER.get(info.kind, frozenset()).isdisjoint(kinds)
    processors = pipeline_for(info, has_own=not is_doubled).processors
    if not processors and info.kind in VALUES and not is_doubled:
        processors = [DeviceValues(info)]
    return SignalPipeline(info, processors)
