"""Puts Mermaid, which draws the diagrams, beside the pages, so that the site loads nothing from elsewhere.

python -m docs.site.diagrams
"""

import base64
import hashlib
import io
import subprocess
import tarfile
import tempfile
from pathlib import Path

from handover_web.build import npm_command

VERSION = "11.17.2"
INTEGRITY = "V6K3C8EBdEsPFZXSKMJe6ppQOENxuHARr9GvHX4hh47lAbhMRD9qf4oEK7LoaRQxULMa80/qt5gHO73aCleBBg=="
"""SHA-512 of the package, as the npm registry states it."""

FILE = Path(__file__).parents[1] / "assets" / "mermaid.min.js"


def main() -> None:
    """Download the package with npm, compare its checksum and unpack the one file of it."""
    if FILE.exists() and f'"{VERSION}"' in FILE.read_text(encoding="utf-8"):
        return
    command, environment = npm_command()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(  # noqa: S603 - the words are ours
            [*command, "pack", "--silent", f"mermaid@{VERSION}"],
            cwd=folder,
            env=environment,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        package = next(Path(folder).glob("*.tgz")).read_bytes()
    if base64.b64encode(hashlib.sha512(package).digest()).decode() != INTEGRITY:
        raise SystemExit(
            f"mermaid {VERSION}: the checksum differs from INTEGRITY in {__file__}; do not use it"
        )
    with tarfile.open(fileobj=io.BytesIO(package)) as archive:
        script = archive.extractfile("package/dist/mermaid.min.js")
        assert script is not None  # noqa: S101 - the package of this checksum has it
        FILE.parent.mkdir(exist_ok=True)
        FILE.write_bytes(script.read())


if __name__ == "__main__":
    main()
