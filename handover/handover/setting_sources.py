"""Where settings come from, and what their texts become: secret files, lists of names, headers, paths."""

import json
import os
import re
from pathlib import Path
from typing import Annotated, Any

from dotenv import dotenv_values
from pydantic import BeforeValidator
from pydantic.fields import FieldInfo
from pydantic_settings import NoDecode, PydanticBaseSettingsSource

from handover.errors import UsageError

PREFIX = "HANDOVER_"
ENV_FILE = ".env"
SECRETS_DIR = f"{PREFIX}SECRETS_DIR"
HEADER_NAME = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
HEADER_VALUE = re.compile(r"[\x21-\x7e]([\x20-\x7e]*[\x21-\x7e])?")
HEADERS_OF_REQUESTS = frozenset(
    {
        "accept", "connection", "content-length", "content-type", "host", "link", "ngsild-tenant",
        "transfer-encoding",
    }
)  # fmt: skip
"""Headers that depend on the request."""

MaybePath = Annotated[Path | None, BeforeValidator(lambda text: text or None)]
"""An optional path; an empty string, as in containers, counts as absent."""


def _split_at_commas(names: object) -> object:
    return [part.strip() for part in names.split(",") if part.strip()] if isinstance(names, str) else names


Names = Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split_at_commas)]
"""Several names, separated by commas in the environment."""
MaybeNames = Annotated[tuple[str, ...] | None, NoDecode, BeforeValidator(_split_at_commas)]
"""The same, where none and no names differ."""


def _secrets_folder() -> str:
    return os.environ.get(SECRETS_DIR) or dotenv_values(ENV_FILE).get(SECRETS_DIR) or ""


def secret_file(name: str) -> Path | None:
    """Return the secret file of the setting `name`; None without one or if the environment has a value."""
    folder = _secrets_folder()
    if not folder or os.environ.get(name):
        return None
    file = Path(folder) / name
    return file if os.path.lexists(file) else None


class SecretFiles(PydanticBaseSettingsSource):
    """Reads settings from the files of `HANDOVER_SECRETS_DIR`."""

    def get_field_value(self, field: FieldInfo, field_name: str) -> tuple[Any, str, bool]:  # noqa: ARG002
        """Return the secret of a setting, None without a file; its name; and that the text is no JSON."""
        name = f"{PREFIX}{field_name}".upper()
        file = secret_file(name)
        if file is None:
            return None, field_name, False
        try:
            return file.read_text(encoding="utf-8").strip(), field_name, False
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
            raise UsageError(
                f"the secret {file} cannot be read: {reason}; make it a text file that the user of this "
                f"service can read, or set {name}"
            ) from None

    def __call__(self) -> dict[str, Any]:
        """Return the secrets that have a file."""
        if not _secrets_folder():  # looked up once: `.env` is read each time
            return {}
        secrets = {name: self.get_field_value(info, name)[0] for name, info in self._fields()}
        return {name: secret for name, secret in secrets.items() if secret is not None}

    def _fields(self) -> list[tuple[str, FieldInfo]]:
        return list(self.settings_cls.model_fields.items())


def headers_in(text: str) -> dict[str, str]:
    """Return the headers in a JSON object; raise `ValueError` for another text, or a header of ours."""
    try:
        headers = json.loads(text)
    except ValueError:
        headers = None
    if not isinstance(headers, dict) or not headers:
        raise ValueError('must be a JSON object of headers, as {"X-Auth-Token": "secret"}')
    for name, value in headers.items():
        if not HEADER_NAME.fullmatch(name) or name.lower() in HEADERS_OF_REQUESTS:
            raise ValueError(
                f"cannot have the header {name!r}: it is no name of a header, or set by Handover"
            )
        if not isinstance(value, str) or not HEADER_VALUE.fullmatch(value):
            raise ValueError(f"has no text of printable ASCII characters for the header {name!r}")
    return headers
