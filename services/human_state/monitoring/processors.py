"""What analyses a signal: the pipelines of `processing`, and values that devices compute."""

from collections.abc import Collection

from services.human_state.model.signals import SignalInfo, SignalKind
from services.human_state.monitoring.device_values import VALUES, DeviceValues
from services.human_state.processing.pipeline import SignalPipeline, processors_for


def pipeline_of(info: SignalInfo, kinds: Collection[SignalKind]) -> SignalPipeline:
    """Return the processors of a signal of a sensor that sends `kinds`.

    The heart rate of a device that sends an ECG is not used as well: two series of one sensor would mix.
    Raises `ValueError` for a signal that cannot be analysed, an ECG of 10 Hz for example.
    """
    processors = processors_for(info)
    is_doubled = info.kind is SignalKind.HEART_RATE and SignalKind.ECG in kinds
    if not processors and info.kind in VALUES and not is_doubled:
        processors = (DeviceValues(info),)
    return SignalPipeline(info, processors)
