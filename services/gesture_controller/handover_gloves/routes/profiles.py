"""REST of profiles: everything stored for a person, as a file."""

from collections.abc import Iterator
from contextlib import contextmanager

import orjson
from fastapi import FastAPI, Request, Response

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.http.body_limit import max_body
from handover.messages import text_of
from handover.runtime.offload import Offload, OffloadFailed
from handover.security.guard import authenticated, guard_of, require
from handover.security.permissions import Permission
from handover.serving.service import YAML_TYPES, accepts
from handover_gloves.configuration.lined_yaml import WrongFile
from handover_gloves.people import profile_file
from handover_gloves.people.people import require_person_name
from handover_gloves.people.profile_file import Profile
from handover_gloves.people.views import PersonView
from handover_gloves.routes.people_views import PeopleParts, of_person, person_view

YAML = "application/yaml"
MAX_PROFILE_BYTES = 1_000_000
MAX_INLINE_BYTES = 4_096
"""A longer profile is read and written in another process, since it would block the event loop."""


def add_profiles(app: FastAPI, parts: PeopleParts) -> None:
    """Add the routes of profiles."""
    routes = TaggedRoutes(app, "people")
    offload = Offload()

    @routes.get(
        "/people/{person}/profile.yaml",
        response_class=Response,
        responses=sends(YAML),
        dependencies=[require(Permission.READ, of_person)],
    )
    async def profile(person: str) -> Response:
        """Return the profile of a person as a file, to be imported here or at another site."""
        owner = parts.people.named(person)
        kept = Profile(owner, parts.records.fits_of(owner.name))
        learnt = [fit.learnt for fit in kept.fits.values()]
        if len(orjson.dumps(learnt)) + 200 * len(owner.gestures) <= MAX_INLINE_BYTES:
            text = profile_file.written(kept)
        else:
            text = await offload.run(profile_file.written, kept)
        name = f'attachment; filename="{owner.name}.yaml"'
        return Response(text, media_type=YAML, headers={"Content-Disposition": name})

    @routes.put("/people/{person}/profile.yaml", dependencies=[require(Permission.CONFIGURE, of_person)])
    @accepts(*YAML_TYPES)
    @max_body(2 * MAX_PROFILE_BYTES)
    async def import_profile(person: str, request: Request) -> PersonView:
        """Import a profile in place of everything stored for this person, in one transaction.

        422 names the line, the rule and the remedy. The name in the URL counts, not the one in the file.
        """
        require_person_name(person)
        if person not in parts.people.names():
            guard_of(request).require(
                await authenticated(request), Permission.MANAGE_PEOPLE, of_person(request)
            )
        parts.require_no_study(person)
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_PROFILE_BYTES:
                raise Problem.translated(
                    413,
                    "Too long",
                    "people.profile_too_long",
                    "a profile has {limit} bytes at most",
                    limit=MAX_PROFILE_BYTES,
                )
        with _profile_errors():
            text = body.decode("utf-8")
            if len(body) <= MAX_INLINE_BYTES:
                imported = profile_file.read(text, parts.people.site, person=person)
            else:
                imported = await offload.run(profile_file.read, text, parts.people.site, person=person)
        await parts.wearers.import_profile(imported.person, imported.fits)
        return person_view(person, parts)


@contextmanager
def _profile_errors() -> Iterator[None]:
    try:
        yield
    except UnicodeDecodeError:
        raise Problem.translated(
            422, "Wrong profile", "people.profile_not_utf8", "profile.yaml: not UTF-8 text; save it as UTF-8"
        ) from None
    except WrongFile as error:
        raise Problem(422, "Wrong profile", text_of(error)) from None
    except OffloadFailed as error:
        raise Problem.translated(
            422,
            "Wrong profile",
            "people.profile_not_read",
            "profile.yaml cannot be read ({error}); make it smaller",
            error=text_of(error),
        ) from None
