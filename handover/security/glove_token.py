"""The token of all gloves of a site, as far as they have none of their own.

It is a setting (`HANDOVER_GLOVE_TOKEN`). On a machine with accounts every glove needs a token, also on
loopback; so setting up accounts makes one in the security directory, which the gesture controller, the
simulated operator and `handover glove` of the same machine read.
"""

from pathlib import Path
from typing import Final

from pydantic import SecretStr

from handover.durable_files import replace_durably
from handover.errors import UsageError
from handover.security.secret_tokens import new_token

GLOVE_TOKEN_FILE: Final = "glove-token"  # noqa: S105 - the name of a file


def site_glove_token(given: SecretStr | None, folder: Path) -> str | None:
    """Return the token of the setting, else that in the security directory `folder`; None without one."""
    if given is not None and given.get_secret_value():
        return given.get_secret_value()
    try:
        return (folder / GLOVE_TOKEN_FILE).read_text(encoding="utf-8").strip() or None
    except OSError:  # none was made, or it is for the user of another service
        return None


def make_glove_token(folder: Path) -> None:
    """Make the token in the security directory unless there is one. Raises `UsageError`."""
    file = folder / GLOVE_TOKEN_FILE
    if file.exists():
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_durably(file, f"{new_token('glove')}\n".encode(), mode=0o600)
    except OSError as error:
        raise UsageError(f"the token of gloves cannot be written to {file}: {error.strerror}") from None
