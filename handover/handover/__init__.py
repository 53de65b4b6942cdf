"""The kit of every component: NGSI-LD client, Performer, settings, telemetry, database and security.

It does not know gloves, robots or processes. Only the command line, `handover_cell`, imports the services.
"""

import sys as _sys


class _MovedModules:
    """Finds modules of the kit by the names that they had before they were in folders, until 1.0."""

    finds_renamed_modules = True

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> object:
        if not name.startswith("handover."):
            return None
        from handover.renamed_modules import find_spec  # noqa: PLC0415 - only for a name that nothing else has

        return find_spec(name, path, target)  # type: ignore[arg-type]


_sys.meta_path.append(_MovedModules())  # type: ignore[arg-type]  # the last, so that it costs nothing
