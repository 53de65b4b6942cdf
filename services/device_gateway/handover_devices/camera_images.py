"""The newest image of each camera, in memory only: what the person who drives sees.

A device sends images over HTTP, or over its connection, there in parts if they do not fit into a line; each
replaces the one before. Nothing is stored, and nothing queues: an image that comes too soon after the last
one is refused. The number of cameras and the size of an image are bounded, so that images, with one that is
not complete for each camera, take at most `2 * MAX_CAMERAS * MAX_IMAGE_BYTES`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from handover.errors import Problem
from handover_devices.protocol.live import ImagePart
from handover_devices.protocol.messages import BadMessage
from handover_devices.registry.pictures import media_type_of

MAX_IMAGE_BYTES: Final = 512 * 1024
MAX_CAMERAS: Final = 64
MIN_INTERVAL_S: Final = 0.05
TOO_FAST: Final = 429


@dataclass(frozen=True, slots=True)
class CameraImage:
    """One image: its number counts up with each image of the gateway; `at_s` is Unix time."""

    number: int
    at_s: float
    media_type: str
    content: bytes


class CameraImages:
    """The newest images by the name of the device."""

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        self._images: dict[str, CameraImage] = {}
        self._partial: dict[str, tuple[int, int, bytearray]] = {}
        """Of an image that is not complete: its frame, how many parts have come, and their content."""
        self._number = 0
        self._now = now

    def put(self, device: str, content: bytes) -> CameraImage:
        """Replace the image of a device.

        Raises `Problem`: 422 for content that is no picture, 429 too soon after the last one, 409 for too
        many cameras.
        """
        media_type, now_s, before = media_type_of(content), self._now(), self._images.get(device)
        if before is not None and 0 <= now_s - before.at_s < MIN_INTERVAL_S:
            raise Problem.translated(
                TOO_FAST,
                "Too many images",
                "device.images_too_fast",
                "{device} may send {rate} images a second; wait before the next one",
                device=device,
                rate=round(1 / MIN_INTERVAL_S),
            )
        if before is None:
            self._require_place(device, len(self._images))
        self._number += 1
        image = self._images[device] = CameraImage(self._number, now_s, media_type, content)
        return image

    def put_part(self, device: str, part: ImagePart) -> CameraImage | None:
        """Add a part of an image; return the image once it is complete.

        One that comes too soon after the last one is dropped, as on a slow network. Raises `BadMessage`.
        """
        frame, count, content = self._partial.pop(device, (part.frame, 0, bytearray()))
        if part.part == 0:
            frame, count, content = part.frame, 0, bytearray()
        if frame != part.frame or count != part.part:
            raise BadMessage(
                "imagePartMissing",
                f"part {part.part} of image {part.frame} does not follow the part before; send the parts "
                "of an image in their order",
            )
        content += part.content
        if len(content) > MAX_IMAGE_BYTES:
            raise BadMessage("imageTooLarge", f"an image has at most {MAX_IMAGE_BYTES} bytes")
        try:
            if part.part == part.parts - 1:
                return self.put(device, bytes(content))
            self._require_place(device, len(self._partial))
        except Problem as problem:
            if problem.status == TOO_FAST:
                return None
            raise BadMessage("imageRefused", str(problem.detail)) from None
        self._partial[device] = frame, count + 1, content
        return None

    def of(self, device: str) -> CameraImage | None:
        """Return the newest image of a device."""
        return self._images.get(device)

    def delete(self, device: str) -> None:
        """Forget a device that was deleted."""
        self._images.pop(device, None)
        self._partial.pop(device, None)

    def _require_place(self, device: str, count: int) -> None:
        if device not in self._images and count >= MAX_CAMERAS:
            raise Problem.translated(
                409,
                "Too many cameras",
                "device.too_many_cameras",
                "{count} devices send images already; stop one and delete it",
                count=MAX_CAMERAS,
            )
