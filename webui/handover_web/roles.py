"""The roles as the page has them, generated from `handover.security.permissions`.

    python -m handover_web.roles            # write app/src/session/roles.json and app/src/i18n/*/roles.json
    python -m handover_web.roles --check    # fail if a file is not up to date

The first load has the roles of people and what each permission needs; the texts load with the pages that show
them, in the language of the page.
"""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from handover.security.permissions import Permission, Role

SOURCES: Final = Path(__file__).parents[1] / "app" / "src"


def main(arguments: Sequence[str]) -> None:
    """Write the files, or compare them with the roles."""
    for name, content in files(Role).items():
        path = SOURCES / name
        text = json.dumps(content, ensure_ascii=False, indent=2) + "\n"
        if list(arguments) != ["--check"]:
            path.write_text(text, encoding="utf-8")
        elif not path.is_file() or path.read_text(encoding="utf-8") != text:
            raise SystemExit(f"{path} is not up to date; run python -m handover_web.roles")


def files(roles: Iterable[Role]) -> Mapping[str, Any]:
    """Return the content of each file by its path in the sources of the page."""
    every_role = tuple(roles)
    of_people = [role for role in every_role if role.is_of_people]
    having = {
        permission.value: [role.value for role in of_people if permission in role.permissions]
        for permission in Permission
    }
    contents: dict[str, Any] = {
        "session/roles.json": {
            "roles": [role.value for role in of_people],
            "having": {permission: holders for permission, holders in having.items() if holders},
        }
    }
    for language in sorted({language for role in every_role for language in role.texts}):
        contents[f"i18n/{language}/roles.json"] = {
            "name": {role.value: role.texts[language][0] for role in every_role},
            "may": {role.value: role.texts[language][1] for role in every_role},
        }
    return contents


if __name__ == "__main__":
    main(sys.argv[1:])
