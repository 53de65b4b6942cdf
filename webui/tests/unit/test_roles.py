"""The page says which role has a permission; the services decide by the same table."""

import json

from handover.security.permissions import ROLE_PERMISSIONS, Permission, Role
from tests.kit.paths import REPOSITORY


def test_the_page_names_the_roles_of_each_permission() -> None:
    shown = json.loads((REPOSITORY / "webui/app/src/session/roles.json").read_text(encoding="utf-8"))
    roles = [role for role in Role if role not in {Role.SERVICE, Role.PERFORMER}]  # those of people
    assert shown == {
        permission: [role for role in roles if permission in ROLE_PERMISSIONS[role]]
        for permission in Permission
        if permission not in {Permission.VERIFY_CALLERS, Permission.PERFORM_FOR_DEVICES}
    }
