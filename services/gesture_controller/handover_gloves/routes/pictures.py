"""Pictures by URL: `/gestures/Thumbs up.svg`, `/gestures/thumbs-up.gif?hand=left`, `/gestures/02222.svg`."""

import asyncio
import hashlib
import re
from functools import lru_cache
from typing import Annotated
from urllib.parse import quote

from fastapi import FastAPI, Header, Response

from handover.distribution import install_command
from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.guard import require_somewhere
from handover.security.permissions import Permission
from handover_gloves.pictures.motion import Hand, Motion, Pose
from handover_gloves.pictures.svg import svg_of
from handover_gloves.recognition.gestures import Gestures, TwoHandGesture

FRESH_S = 3600
_STATES = re.compile(r"[012]{5}")
_NON_WORD = re.compile(r"[\W_]+")


def picture_urls(gesture: str) -> dict[str, str]:
    """Return where the pictures of `gesture` are, as paths of this service."""
    return {kind: f"/gestures/{quote(gesture)}.{kind}" for kind in ("svg", "gif")}


def add_pictures(app: FastAPI, gestures: Gestures) -> None:
    """Add the routes of the pictures of `gestures`."""
    routes = TaggedRoutes(app, "gestures")

    @routes.get(
        "/gestures/{name}.svg",
        response_class=Response,
        responses=sends("image/svg+xml"),
        dependencies=[require_somewhere(Permission.READ)],
    )
    async def svg(
        name: str,
        hand: Hand = "right",
        motion: Motion = "loop",
        if_none_match: Annotated[str | None, Header()] = None,
    ) -> Response:
        """Draw a gesture by its name or its five states, moving from an open hand or at rest.

        A two-hand gesture shows both hands and ignores `hand`; a sequence shows its gestures in order.
        """
        title, poses = _poses_of(name, gestures, hand)
        return _answer(svg_of(title, poses, motion).encode(), "image/svg+xml", if_none_match)

    @routes.get(
        "/gestures/{name}.gif",
        response_class=Response,
        responses=sends("image/gif"),
        dependencies=[require_somewhere(Permission.READ)],
    )
    async def gif(
        name: str,
        hand: Hand = "right",
        motion: Motion = "loop",
        if_none_match: Annotated[str | None, Header()] = None,
    ) -> Response:
        """Draw the same as a GIF (less than 100 kB, on white) for systems without SVG."""
        _, poses = _poses_of(name, gestures, hand)
        return _answer(await asyncio.to_thread(_gif, poses, motion), "image/gif", if_none_match)


@lru_cache(maxsize=256)
def _gif(poses: tuple[Pose, ...], motion: Motion) -> bytes:
    try:
        from handover_gloves.pictures.gif import gif_of  # noqa: PLC0415 - loads Pillow
    except ModuleNotFoundError as error:
        raise Problem.translated(
            501,
            "Not installed",
            "gesture.gif_not_installed",
            "a GIF needs {library}; take the SVG, or install the extra: {command}",
            library=error.name,
            command=install_command("gif"),
        ) from None
    return gif_of(poses, motion)


def _poses_of(name: str, gestures: Gestures, hand: Hand) -> tuple[str, tuple[Pose, ...]]:
    """Return the name of the gesture and its hands; `name` may be spelt as a file name."""
    if _STATES.fullmatch(name):
        return gestures.names.get(name, name), (Pose(hand, (name,)),)
    everything = (*gestures.codes, *gestures.composites)
    title = gestures.find(name) or next(
        (candidate for candidate in everything if _plain(candidate) == _plain(name)), None
    )
    if title is None:
        raise Problem.translated(
            404,
            "Unknown gesture",
            "gesture.unknown_gesture",
            'there is no gesture "{name}"; {hint}, or give five states, thumb first, such as '
            "02222 (0 straight, 1 between, 2 bent)",
            name=name,
            hint=gestures.like(name),
        )
    parts = gestures.parts_of(title)
    if isinstance(gestures.composites.get(title), TwoHandGesture):
        return title, tuple(Pose(part.hand or hand, (part.code,)) for part in parts)
    return title, (Pose(hand, tuple(part.code for part in parts)),)


def _plain(name: str) -> str:
    return _NON_WORD.sub("-", name.casefold()).strip("-")


def _answer(picture: bytes, media_type: str, title: str | None) -> Response:
    tag = f'"{hashlib.sha256(picture).hexdigest()[:24]}"'
    headers = {"ETag": tag, "Cache-Control": f"public, max-age={FRESH_S}"}
    if title is not None and (title.strip() == "*" or tag in title):
        return Response(status_code=304, headers=headers)
    return Response(picture, media_type=media_type, headers=headers)
