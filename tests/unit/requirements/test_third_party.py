"""The list of third-party packages refuses licences that Apache-2.0 software cannot be distributed with."""

import pytest

from requirements.third_party import LicenceError, Package, accepted, document


@pytest.mark.parametrize(
    "licence",
    [
        "GPL-3.0-only",
        "AGPL-3.0-or-later",
        "GNU General Public License v2 (GPLv2)",
        "MIT AND GPL-2.0-only",
        "SSPL-1.0",
    ],
)
def test_copyleft_licence_is_refused(licence: str) -> None:
    with pytest.raises(LicenceError, match=f'"library" has the licence .*{licence[:3]}'):
        accepted("library", licence)


@pytest.mark.parametrize(
    "licence", ["MIT", "LGPL-3.0-only", "GPL-2.0-only OR MIT", "MPL-2.0 AND (Apache-2.0 OR MIT)"]
)
def test_licence_with_a_compatible_choice_is_accepted(licence: str) -> None:
    assert accepted("library", licence) == licence


def test_package_without_a_licence_is_refused() -> None:
    with pytest.raises(LicenceError, match='"library" names no licence'):
        accepted("library", "")


def test_equal_licence_texts_are_written_once() -> None:
    page = [Package(name, "MIT", "https://example.org", ("MIT License",)) for name in ("a", "b")]
    text = document([], page)
    assert text.count("MIT License") == 1
    assert "### a, b" in text
