"""Gestures as in REST responses. The page's TypeScript types are generated from them."""

from typing import NotRequired

from typing_extensions import TypedDict


class PlainGestureView(TypedDict):
    """A gesture that is one hand shape; `code` has five finger states, thumb first."""

    name: str
    code: str
    commandId: int | None


class PartView(TypedDict):
    """A part of a composite gesture."""

    gesture: str
    code: str


class CompositeGestureView(TypedDict):
    """A gesture of both hands (`left` and `right`), or of two shapes in `sequence`."""

    name: str
    commandId: int | None
    left: NotRequired[PartView]
    right: NotRequired[PartView]
    sequence: NotRequired[list[PartView]]


class PictureUrls(TypedDict):
    """The paths of the pictures of a gesture."""

    svg: str
    gif: str


class PlainSiteGesture(PlainGestureView):
    """A gesture of the site that is one hand shape."""

    pictures: PictureUrls


class CompositeSiteGesture(CompositeGestureView):
    """A composite gesture of the site."""

    pictures: PictureUrls
