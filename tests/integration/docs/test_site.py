"""The documentation site builds without warnings and without a network; its reference is checked by make."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kit.paths import REPOSITORY

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    subprocess.run([sys.executable, "-m", "docs.site.diagrams"], cwd=REPOSITORY, check=True)
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)],
        cwd=REPOSITORY,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.mark.nightly
def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    loaded = re.compile(r'<(?:script|img|iframe)[^>]+src="(https?:[^"]+)|<link[^>]+href="(https?:[^"]+)')
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 20
    external = [(page.name, found[0]) for page in pages for found in loaded.finditer(page.read_text())]
    assert [one for one in external if 'rel="canonical"' not in one[1]] == []


def test_diagrams_are_drawn_by_the_script_of_the_site(site: Path) -> None:
    assert (site / "assets" / "mermaid.min.js").stat().st_size > 1_000_000
    page = (site / "architecture.html").read_text()
    assert 'class="mermaid"' in page
    assert "assets/mermaid.min.js" in page


def test_links_to_documents_beside_the_code_lead_to_pages(site: Path) -> None:
    page = (site / "how-to" / "production.html").read_text()
    assert 'href="../repository/deploy/index.html"' in page
    assert (site / "repository" / "deploy" / "index.html").exists()
