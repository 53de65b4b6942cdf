"""Pictures: one hand for the page and for files, clear in every state, small, still for who wants it so."""

import io
import itertools
import re
import xml.etree.ElementTree as ET

import httpx
import orjson
import pytest
from fastapi import FastAPI

from handover.security.guard import Guard
from handover.serving.service import create_app
from handover.settings import Settings
from handover_gloves.pictures import hand
from handover_gloves.pictures.gif import gif_of
from handover_gloves.pictures.motion import Pose, moments, whole_s
from handover_gloves.pictures.svg import svg_of
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures, Shape
from handover_gloves.routes.pictures import add_pictures
from tests.kit.paths import REPOSITORY

STATES = ["".join(states) for states in itertools.product("012", repeat=5)]
HORNS = Pose("right", ("20220",))
BOTH = (Pose("left", ("02222",)), Pose("right", ("20222",)))
IN_TURN = Pose("right", ("20222", "20220"))
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def app() -> FastAPI:
    made = create_app("Pictures", description="", guard=Guard(Settings(_env_file=None), "pictures"))
    composed = {
        "Both thumbs up": Shape(left="02222", right="02222"),
        "Wave off": Shape(sequence=("Point with index", "Horns")),
    }
    add_pictures(made, Gestures(M2O2P_GESTURES).with_shapes(composed))
    return made


@pytest.fixture
async def browser(app: FastAPI):
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield client


def test_the_page_draws_its_hands_from_the_same_proportions() -> None:
    ours = REPOSITORY / "services/gesture_controller/handover_gloves/pictures/hand.json"
    pages = REPOSITORY / "webui/app/src/hand/hand.json"
    assert ours.read_bytes() == pages.read_bytes(), "change both files, or neither"


def test_the_page_makes_the_same_shapes_of_them() -> None:
    expected = orjson.loads((REPOSITORY / "webui/app/src/hand/shapes.fixture.json").read_bytes())
    for case in expected:
        shapes = hand.shape_of(case["bends"])
        points = [[*phalanx.start, *phalanx.end] for shape in shapes for phalanx in shape.phalanges]
        assert points == [pytest.approx(one, abs=0.01) for one in case["points"]]
        assert [[phalanx.folded for phalanx in shape.phalanges] for shape in shapes] == case["folded"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_state_has_a_picture_of_its_own(side: str) -> None:
    drawings = {
        re.sub(r"<title>.*?</title>|left|right", "", svg_of("x", [Pose(side, (states,))], "none"))  # type: ignore[arg-type]  # parametrized
        for states in STATES
    }
    assert len(drawings) == len(STATES)


def test_a_left_hand_is_the_mirror_of_a_right_one() -> None:
    assert "scale(-1 1)" in svg_of("x", [Pose("left", ("02222",))])
    assert "scale(-1 1)" not in svg_of("x", [Pose("right", ("02222",))])


def test_an_svg_needs_nothing_else_and_names_the_gesture() -> None:
    root = ET.fromstring(svg_of("Thumb & index", [Pose("right", ("00222",))]))
    assert root.find(f"{SVG}title").text == "Thumb & index"
    ids = {element.get("id") for element in root.iter() if element.get("id")}
    uses = {element.get("href") for element in root.iter(f"{SVG}use")}
    assert uses == {f"#{one}" for one in ids}
    assert not any(
        "href" in name for element in root.iter() for name in element.attrib if element.tag != f"{SVG}use"
    )


def test_an_svg_rests_for_who_prefers_no_motion() -> None:
    root = ET.fromstring(svg_of("Horns", [HORNS]))
    still = next(group for group in root.iter(f"{SVG}g") if group.get("class") == "still")
    moving = next(group for group in root.iter(f"{SVG}g") if group.get("class") == "moving")
    assert not list(still.iter(f"{SVG}animate"))
    assert list(moving.iter(f"{SVG}animate"))
    style = root.find(f"{SVG}style").text
    assert re.search(
        r"prefers-reduced-motion:reduce\)\{\.still\{display:inline\}\.moving\{display:none\}", style
    )


def test_a_straight_finger_does_not_move() -> None:
    assert "<animate" not in svg_of("Open hand", [Pose("right", ("00000",))])


@pytest.mark.parametrize(("motion", "how"), [("loop", 'repeatCount="indefinite"'), ("once", 'fill="freeze"')])
def test_key_times_begin_at_0_rise_and_end_at_1(motion: str, how: str) -> None:
    root = ET.fromstring(svg_of("Horns", [HORNS], motion))  # type: ignore[arg-type]  # parametrized
    animations = list(root.iter(f"{SVG}animate"))
    assert animations
    for animation in animations:
        times = [float(time) for time in animation.get("keyTimes").split(";")]
        assert times[0] == 0
        assert times[-1] == 1
        assert times == sorted(times)
        assert len(times) == len(animation.get("values").split(";"))
    assert how in svg_of("Horns", [HORNS], motion)  # type: ignore[arg-type]  # parametrized


def test_the_movement_begins_with_an_open_hand_and_ends_with_the_gesture() -> None:
    way = moments("20220")
    assert way[0].bends == (0, 0, 0, 0, 0)
    assert way[-1].bends == (2, 0, 2, 2, 0)
    assert way[-1].at_s < whole_s(way)


def test_no_finger_leaves_the_box_on_its_way() -> None:
    width, height = hand.box()
    for states in STATES:
        for moment in moments(states):
            for shape in hand.shape_of(moment.bends):
                for phalanx in shape.phalanges:
                    for (x, y), radius in (
                        (phalanx.start, phalanx.start_radius),
                        (phalanx.end, phalanx.end_radius),
                    ):
                        assert radius + 3 < x < width - radius - 3
                        assert radius + 3 < y < height - radius - 3


def test_a_gif_is_small_moves_and_stays_long_at_the_gesture() -> None:
    from PIL import Image

    largest = gif_of([Pose("right", ("22222",))])  # all five fingers move
    assert len(largest) < 100_000
    picture = Image.open(io.BytesIO(largest))
    assert picture.info["loop"] == 0
    durations = []
    for nth in range(picture.n_frames):
        picture.seek(nth)
        durations.append(picture.info["duration"])
    assert len(durations) == len(moments("22222"))
    assert durations[-1] > 5 * max(durations[1:-1])
    assert picture.convert("RGB").getpixel((2, 2)) == (255, 255, 255)


def test_the_gif_of_a_left_hand_is_the_mirror_image() -> None:
    from PIL import Image, ImageOps

    right, left = (
        Image.open(io.BytesIO(gif_of([Pose(side, ("02222",))], "none"))).convert("RGB")
        for side in ("right", "left")
    )
    assert ImageOps.mirror(right).tobytes() == left.tobytes()
    assert right.tobytes() != left.tobytes()


def test_a_gesture_of_both_hands_shows_the_left_and_the_right_one_beside_each_other() -> None:
    root = ET.fromstring(svg_of("Both", BOTH))
    alone = ET.fromstring(svg_of("Left", BOTH[:1]))
    assert int(root.get("width")) > 2 * int(alone.get("width"))
    assert root.get("height") == alone.get("height")
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    assert {element.get("href")[1:] for element in root.iter(f"{SVG}use")} == set(ids)
    assert svg_of("Both", BOTH) != svg_of("Both", BOTH[::-1])


def test_two_gestures_in_turn_are_played_in_turn_and_rest_beside_each_other() -> None:
    way = moments(*IN_TURN.states)
    stays = [moment.at_s for moment in way if moment.bends == (2, 0, 2, 2, 2)]
    assert stays[-1] - stays[0] > 1, "the first is seen long enough to be copied"
    assert way[-1].bends == (2, 0, 2, 2, 0)
    moving, resting = ET.fromstring(svg_of("x", [IN_TURN])), ET.fromstring(svg_of("x", [IN_TURN], "none"))
    assert int(resting.get("width")) > 2 * int(moving.get("width"))
    assert not list(resting.iter(f"{SVG}animate"))


def test_of_the_same_gesture_twice_the_hand_is_seen_to_open_between() -> None:
    bends = [moment.bends for moment in moments("02222", "02222")]
    first = bends.index((0, 2, 2, 2, 2))
    assert (0, 0, 0, 0, 0) in bends[first:]
    assert bends[-1] == (0, 2, 2, 2, 2)


@pytest.mark.nightly
@pytest.mark.parametrize("poses", [BOTH, [Pose("left", ("22222",)), Pose("right", ("22222",))], [IN_TURN]])
def test_a_gif_of_a_composed_gesture_is_small_too_and_takes_as_long_as_the_svg(poses: list[Pose]) -> None:
    from PIL import Image

    made = gif_of(poses)
    assert len(made) < 100_000
    picture = Image.open(io.BytesIO(made))
    alone = Image.open(io.BytesIO(gif_of([HORNS], "none")))
    assert picture.width == alone.width * len(poses)
    lasts_ms = 0
    for nth in range(picture.n_frames):
        picture.seek(nth)
        lasts_ms += picture.info["duration"]
    assert lasts_ms == pytest.approx(1000 * whole_s(moments(*poses[0].states)), abs=20)


@pytest.mark.parametrize("name", ["Both thumbs up", "wave-off", "WAVE OFF"])
@pytest.mark.parametrize("kind", ["svg", "gif"])
async def test_composed_gestures_have_pictures_by_name(browser, name: str, kind: str) -> None:
    answer = await browser.get(f"/gestures/{name}.{kind}")
    assert answer.status_code == 200
    assert len(answer.content) > 2000


@pytest.mark.parametrize("name", ["Thumbs up", "thumbs up", "thumbs-up", "02222"])
@pytest.mark.parametrize(("kind", "media"), [("svg", "image/svg+xml"), ("gif", "image/gif")])
async def test_a_picture_is_found_by_name_file_name_or_states(
    browser, name: str, kind: str, media: str
) -> None:
    answer = await browser.get(f"/gestures/{name}.{kind}", params={"motion": "none"})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == media
    assert answer.content == (await browser.get(f"/gestures/Thumbs up.{kind}?motion=none")).content


async def test_a_picture_that_is_known_is_not_sent_again(browser) -> None:
    first = await browser.get("/gestures/Horns.svg")
    again = await browser.get("/gestures/Horns.svg", headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304
    assert again.content == b""
    left = await browser.get(
        "/gestures/Horns.svg?hand=left", headers={"If-None-Match": first.headers["etag"]}
    )
    assert left.status_code == 200


async def test_an_unknown_gesture_is_named_with_what_may_have_been_meant(browser) -> None:
    answer = await browser.get("/gestures/Thumb up.svg")
    assert answer.status_code == 404
    assert answer.json()["detail"].startswith('there is no gesture "Thumb up"; did you mean "Thumbs up"')


async def test_an_unknown_hand_is_refused(browser) -> None:
    assert (await browser.get("/gestures/Horns.gif?hand=third")).status_code == 422
