"""Files that clients store for a device: pictures of a reasonable size, and robots that are trees."""

import io
import struct
from contextlib import suppress

import pytest
from PIL import Image

from handover.errors import Problem
from handover_devices.camera_images import CameraImages
from handover_devices.registry.pictures import MAX_SIDE, media_type_of
from handover_devices.registry.urdf import joints_in


def picture(media_type: str, **options: object) -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (300, 200), "red").save(content, media_type.partition("/")[2], **options)
    return content.getvalue()


def claiming(content: bytes, width: int, height: int) -> bytes:
    """Return a picture of 300 x 200 pixels that claims to have others."""
    if content.startswith(b"\x89PNG"):
        return content[:16] + struct.pack(">II", width, height) + content[24:]
    if content.startswith(b"\xff\xd8"):
        at = content.index(struct.pack(">HH", 200, 300))
        return content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]
    if content[12:16] == b"VP8 ":
        return content[:26] + struct.pack("<HH", width, height) + content[30:]
    if content[12:16] == b"VP8L":
        bits = struct.pack("<I", (width - 1) | (height - 1) << 14)
        return content[:21] + bits + content[25:]
    sizes = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    head = b"VP8X" + struct.pack("<I", 10) + bytes(4) + sizes
    return content[:12] + head + content[12:]


PICTURES = {
    "png": ("image/png", picture("image/png")),
    "jpeg": ("image/jpeg", picture("image/jpeg")),
    "progressive jpeg": ("image/jpeg", picture("image/jpeg", progressive=True)),
    "webp": ("image/webp", picture("image/webp")),
    "lossless webp": ("image/webp", picture("image/webp", lossless=True)),
}
LARGE = [(30_000, 30_000), (MAX_SIDE + 1, 1), (1, MAX_SIDE + 1), (8000, 8000)]


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_a_reasonable_size_is_accepted(name: str) -> None:
    media_type, content = PICTURES[name]
    assert media_type_of(content) == media_type
    assert media_type_of(claiming(content, 4000, 3000)) == media_type


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize(("width", "height"), LARGE)
def test_a_picture_that_claims_too_many_pixels_is_refused(name: str, width: int, height: int) -> None:
    content = PICTURES[name][1]
    if "webp" in name and max(width, height) > 16_383:
        width, height = 16_383, 16_383  # more than the format can say
    with pytest.raises(Problem, match=f"{width} x {height}") as refused:
        media_type_of(claiming(content, width, height))
    assert refused.value.status == 422
    with pytest.raises(Problem):
        CameraImages().put("camera-1", claiming(content, width, height))


def test_an_extended_webp_is_judged_by_its_canvas() -> None:
    plain = PICTURES["webp"][1]
    extended = plain[:12] + b"VP8X" + struct.pack("<I", 10) + bytes(4) + b"\x2f\x75\x00" * 2 + plain[12:]
    with pytest.raises(Problem, match="30000 x 30000"):
        media_type_of(extended)


@pytest.mark.parametrize("cut", range(0, 60, 3))
@pytest.mark.parametrize("name", PICTURES)
def test_a_cut_picture_raises_nothing_else(name: str, cut: int) -> None:
    with suppress(Problem):
        media_type_of(PICTURES[name][1][:cut])


JOINT = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/></joint>'


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (JOINT.format("a", "x", "y") + JOINT.format("b", "y", "x"), "loop"),
        (JOINT.format("a", "x", "x"), "loop"),
        (JOINT.format("a", "x", "z") + JOINT.format("b", "y", "z"), "2 parents"),
        (
            '<link name="x"><visual><geometry><mesh filename="file:///etc/passwd"/></geometry></visual></link>',
            "/etc",
        ),
        (
            '<link name="x"><collision><geometry><mesh filename="http://a/b"/></geometry></collision></link>',
            "http",
        ),
    ],
)
def test_a_urdf_with_a_loop_or_a_mesh_from_elsewhere_is_refused(content: str, fault: str) -> None:
    with pytest.raises(Problem, match=fault) as refused:
        joints_in(f'<robot name="r">{content}</robot>'.encode())
    assert refused.value.status == 422
