"""Hooks of MkDocs: documents beside the code become pages, and links to code become addresses or plain names.

Markdown in `docs/` links to other files of the repository with relative paths, so that the links work where
the repository is browsed. On the site, a link to a file of `INCLUDED` leads to its page under `repository/`;
a link to any other file leads to the host of the repository, if pyproject.toml names it, and is plain text
otherwise.
"""

import os.path
import posixpath
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
INCLUDED = {
    path: f"repository/{path}"
    for path in (
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "SECURITY.md",
        "deploy/README.md",
        "ros_fiware_bridge/README.md",
        "ros_fiware_bridge/handover_ros/graph/README.md",
        "services/context_broker/README.md",
        "services/context_broker/handover_broker/operations.md",
        "services/gesture_controller/handover_gloves/recognition/README.md",
        "webui/README.md",
    )
    if (ROOT / path).exists()
}
DECISIONS = "<!-- decisions -->"
LINK = re.compile(r"(?P<mark>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s#]+)(?P<anchor>#[^)\s]*)?\)")
FENCE = re.compile(r"(^```.*?^```\s*$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Take the address of the repository from pyproject.toml, the one place that names it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.repo_url = project.get("urls", {}).get("Repository")
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents beside the code, and the pictures of the page."""
    for path, address in INCLUDED.items():
        files.append(File.generated(config, address, abs_src_path=str(ROOT / path)))
    for picture in sorted((ROOT / "webui" / "pictures").iterdir()):
        address = f"repository/webui/pictures/{picture.name}"
        files.append(File.generated(config, address, abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the text of a page with links that work on the site."""
    address = page.file.src_uri
    source = address.removeprefix("repository/") if address.startswith("repository/") else f"docs/{address}"

    def on_site(found: re.Match[str]) -> str:
        target = found["target"]
        if re.match(r"[a-z]+:", target) or target.startswith("/"):
            return found[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        if not (ROOT / path).exists():
            raise PluginError(f"{source}: the link to {target} leads nowhere; correct it")
        there = _address(path, files)
        if there is not None:
            relative = os.path.relpath(there, posixpath.dirname(address) or ".")
            return f"{found['mark']}[{found['text']}]({relative}{found['anchor'] or ''})"
        if config.repo_url:
            return f"[{found['text']}]({config.repo_url.rstrip('/')}/blob/main/{path}{found['anchor'] or ''})"
        return found["text"]

    markdown = markdown.replace(DECISIONS, "\n".join(_decisions()))
    parts = FENCE.split(markdown)
    return "".join(part if index % 2 else LINK.sub(on_site, part) for index, part in enumerate(parts))


def _decisions() -> Iterator[str]:
    for path in sorted((ROOT / "docs" / "adr").glob("[0-9]*.md")):
        title = path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
        yield f"- [{title}]({path.name})"


def _address(path: str, files: Files) -> str | None:
    """Return the address on the site of a file of the repository, None if it is not there."""
    if path in INCLUDED:
        return INCLUDED[path]
    if path.startswith("webui/pictures/"):
        return f"repository/{path}"
    if path.startswith("docs/"):
        inside = path.removeprefix("docs/")
        return inside if files.get_file_from_path(inside) is not None else None
    return None
