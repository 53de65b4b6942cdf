"""Bearer tokens of a cell with accounts, for tests of what a caller may do."""

from pathlib import Path

from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant

KEY = SigningKey.generate()
UR10 = "urn:ngsi-ld:Device:demo:ur10-1"


def set_up_accounts(folder: Path) -> None:
    (folder / "security").mkdir()
    (folder / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))


def bearer(
    *grants: Grant, subject: str = "subject-1", revision: int = 0, valid_s: float = 60
) -> dict[str, str]:
    caller = Caller(CallerKind.USER, subject, "Anna", grants, revision=revision, session="session-1")
    return {"Authorization": f"Bearer {KEY.issue(caller, valid_s=valid_s)}"}
