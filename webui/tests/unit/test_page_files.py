"""The files of the page: caching, compression, routes, and a page that is not built."""

from pathlib import Path

import pytest
from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response

from handover.errors import Problem
from handover_web import build
from handover_web.http import page_files
from handover_web.http.page_files import CACHE_FOREVER, REVALIDATE, PageFiles


@pytest.fixture
def page(tmp_path: Path) -> PageFiles:
    folder = tmp_path / "page"
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html><title>Handover</title>")
    (folder / "assets" / "index-1a2b.js").write_text("export default 1;")
    (folder / "assets" / "index-1a2b.js.br").write_bytes(b"packed with brotli")
    (folder / "assets" / "index-1a2b.js.gz").write_bytes(b"packed with gzip")
    (folder / ".built-from").write_text("sources")
    (tmp_path / "secret.txt").write_text("not for anybody")
    return PageFiles(folder)


def body(response: Response) -> bytes:
    return Path(response.path).read_bytes() if isinstance(response, FileResponse) else bytes(response.body)


async def ask(page: PageFiles, address: str, **headers: str) -> Response:
    return await page.respond(
        address, Headers({name.replace("_", "-"): value for name, value in headers.items()})
    )


@pytest.mark.parametrize("address", ["", "work", "processes/bin-picking-1", "processes/a.b", "system"])
async def test_routes_of_the_page_return_the_index(page: PageFiles, address: str) -> None:
    answer = await ask(page, address)
    assert b"Handover" in body(answer)
    assert answer.headers["cache-control"] == REVALIDATE
    assert answer.headers["content-type"] == "text/html; charset=utf-8"


async def test_files_with_a_hash_are_cached_forever(page: PageFiles) -> None:
    answer = await ask(page, "assets/index-1a2b.js")
    assert body(answer) == b"export default 1;"
    assert answer.headers["cache-control"] == CACHE_FOREVER
    assert answer.headers["content-type"].startswith("text/javascript")


@pytest.mark.parametrize(
    ("accepted", "encoding"),
    [
        ("gzip, deflate, br", "br"),
        ("gzip", "gzip"),
        ("br;q=0, gzip;q=0.5", "gzip"),
        ("identity", None),
        ("", None),
    ],
)
async def test_compressed_files_are_negotiated(page: PageFiles, accepted: str, encoding: str | None) -> None:
    answer = await ask(page, "assets/index-1a2b.js", accept_encoding=accepted)
    assert answer.headers.get("content-encoding") == encoding
    assert answer.headers["content-type"].startswith("text/javascript")
    assert answer.headers["vary"] == "Accept-Encoding"


async def test_a_new_version_is_sent_and_ranges_are_read_from_the_disk(
    page: PageFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = await ask(page, "")
    assert not isinstance(first, FileResponse)
    assert isinstance(await ask(page, "", range="bytes=0-3"), FileResponse)
    (tmp_path / "page" / "index.html").write_text("<!doctype html><title>Handover, built again</title>")
    monkeypatch.setattr(page_files, "FRESH_S", 0.0)
    page._found.clear()
    again = await ask(page, "")
    assert b"built again" in body(again)
    assert again.headers["etag"] != first.headers["etag"]
    monkeypatch.setattr(page_files, "MAX_KEPT_FILE_BYTES", 5)
    (tmp_path / "page" / "index.html").write_text("<!doctype html><title>Handover, longer</title>")
    assert isinstance(await ask(page, "work"), FileResponse)


async def test_unchanged_files_are_answered_with_304(page: PageFiles) -> None:
    first = await ask(page, "")
    again = await ask(page, "", if_none_match=f'"other", W/{first.headers["etag"]}')
    assert again.status_code == 304
    assert (await ask(page, "", if_none_match='"other"')).status_code == 200


@pytest.mark.parametrize(
    "address",
    ["assets/index-9z.js", "missing.png", "../secret.txt", "assets/../../secret.txt", "a/b..png"],
)
async def test_missing_and_outside_files_are_not_found(page: PageFiles, address: str) -> None:
    with pytest.raises(Problem) as missing:
        await ask(page, address)
    assert missing.value.status == 404


@pytest.mark.parametrize("address", ["/etc/hostname", "a\0b", "..\\secret", "....", ".built-from", "assets"])
async def test_other_addresses_return_the_index(page: PageFiles, address: str) -> None:
    assert b"Handover" in body(await ask(page, address))


async def test_an_unbuilt_page_explains_how_to_build_it(tmp_path: Path) -> None:
    page = PageFiles(tmp_path / "nowhere")
    assert not page.is_built
    answer = await ask(page, "work")
    assert answer.status_code == 503
    assert b"make setup" in bytes(answer.body)


def test_the_files_are_where_the_build_writes_them() -> None:
    assert page_files.FOLDER == build.PAGE
