"""Samples of Cyclone: the bytes of a message, the time it was sent and its writer.

The Python binding of Cyclone takes samples without their writer, and holds the GIL while it writes. This
module calls the C library for both, with the container that the C part of the binding fills (a pointer and a
size).
"""

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

TIMEOUT = -10


class Sample(NamedTuple):
    """A sample; `data` is None if its writer has left; `sent_ns` is since 1970, by the sender's clock."""

    data: bytes | None
    sent_ns: int
    writer: int
    """The instance handle of the writer, as in discovery."""


class _Info(ctypes.Structure):
    _fields_ = (
        ("sample_state", ctypes.c_uint32),
        ("view_state", ctypes.c_uint32),
        ("instance_state", ctypes.c_uint32),
        ("valid_data", ctypes.c_bool),
        ("source_timestamp", ctypes.c_int64),
        ("instance_handle", ctypes.c_uint64),
        ("publication_handle", ctypes.c_uint64),
        ("disposed_generation_count", ctypes.c_uint32),
        ("no_writers_generation_count", ctypes.c_uint32),
        ("sample_rank", ctypes.c_uint32),
        ("generation_rank", ctypes.c_uint32),
        ("absolute_generation_rank", ctypes.c_uint32),
    )


class _Container(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t))


def _function(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    from cyclonedds.internal import DDS  # noqa: PLC0415 - heavy

    # Looked up by key, so that the binding's own reference to the function keeps its argument types.
    function = DDS._dll_handle[name]
    function.restype, function.argtypes = result, arguments
    return function


class SampleTaker:
    """Takes samples from readers; one per thread, since it reuses its buffers."""

    def __init__(self, at_once: int = 32) -> None:
        self._at_once = at_once
        self._containers = (_Container * at_once)()
        self._infos = (_Info * at_once)()
        size = ctypes.sizeof(_Container)
        start = ctypes.addressof(self._containers)
        self._places = (ctypes.c_void_p * at_once)(*(start + n * size for n in range(at_once)))
        self._take = _function(
            "dds_take",
            ctypes.c_int32,
            ctypes.c_int32,
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_size_t,
            ctypes.c_uint32,
        )
        self._free = _function("dds_free", None, ctypes.c_void_p)

    def take(self, reader: Any) -> list[Sample]:
        """Return the samples that have not been taken, up to the size of the buffers; oldest first.

        Raises:
            OSError: the reader was closed.
        """
        count = self._take(reader._ref, self._places, self._infos, self._at_once, self._at_once)
        if count < 0:
            raise OSError(f"taking from a DDS reader failed with {count}")
        samples = []
        for n in range(count):
            container, info = self._containers[n], self._infos[n]
            data = None
            if container.data:
                if info.valid_data:
                    data = ctypes.string_at(container.data, container.size)
                self._free(container.data)
                container.data = None
            samples.append(Sample(data, info.source_timestamp, info.publication_handle))
        return samples


class SampleSender:
    """Writes samples while other threads run."""

    def __init__(self) -> None:
        self._write = _function("dds_write", ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p)

    def write(self, writer: Any, data: bytes) -> int:
        """Write `data` (CDR with header); return 0, `TIMEOUT` if readers are too slow, or a DDS error."""
        padded = data if not len(data) % 4 else data + bytes(-len(data) % 4)
        container = _Container(ctypes.cast(ctypes.c_char_p(padded), ctypes.c_void_p), len(padded))
        return int(self._write(writer._ref, ctypes.byref(container)))


class ReaderWaitSet:
    """Wakes one thread when a reader has samples; each reader has a number."""

    STOP = 0

    def __init__(self, participant: Any) -> None:
        from cyclonedds.core import GuardCondition, WaitSet  # noqa: PLC0415 - heavy

        self._waitset = WaitSet(participant)
        self._guard = GuardCondition(participant)
        ref = ctypes.c_int32
        self._attach = _function("dds_waitset_attach", ref, ref, ref, ctypes.c_void_p)
        self._detach = _function("dds_waitset_detach", ref, ref, ref)
        self._wait = _function("dds_waitset_wait", ref, ref, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64)
        self._signalled = (ctypes.c_void_p * 64)()
        self._attach(self._waitset._ref, self._guard._ref, self.STOP)

    def attach(self, condition: Any, number: int) -> None:
        """Signal `number` (1 or more) while `condition` holds."""
        self._attach(self._waitset._ref, condition._ref, number)

    def detach(self, condition: Any) -> None:
        """Stop signalling `condition`."""
        self._detach(self._waitset._ref, condition._ref)

    def wait(self, timeout_ns: int) -> list[int]:
        """Wait and return the signalled numbers; empty after the timeout."""
        count = self._wait(self._waitset._ref, self._signalled, len(self._signalled), timeout_ns)
        if count < 0:
            return [self.STOP]
        return [self._signalled[n] or 0 for n in range(min(count, len(self._signalled)))]

    def stop(self) -> None:
        """Signal `STOP` from now on."""
        self._guard.set(True)

    def close(self) -> None:
        """Close the wait set; no thread may wait on it any more."""
        self._waitset.__del__()
        self._guard.__del__()
