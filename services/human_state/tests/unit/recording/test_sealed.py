import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.recording.sealed import SealedReader, SealedWriter, SealError, chunks_of

KEY = bytes(range(32))
HEADER_BYTES = 48


def sealed(path: Path, pieces: list[bytes]) -> bytes:
    with path.open("wb") as file:
        writer = SealedWriter(file, KEY, "R-1")
        for piece in pieces:
            writer.write(piece)
            writer.seal()
        writer.close()
    return path.read_bytes()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sealed") / "file"


def opened(content: bytes, *, key: bytes = KEY, name: str = "R-1", is_cut: bool = False) -> list[bytes]:
    return list(chunks_of(io.BytesIO(content), key, name, is_cut=is_cut))


@given(pieces=st.lists(st.binary(max_size=70), max_size=6), is_long=st.booleans())
def test_what_was_written_is_read(path: Path, pieces: list[bytes], *, is_long: bool) -> None:
    given_pieces = [*pieces, bytes(200_000)] if is_long else pieces
    content = sealed(path, given_pieces)
    assert b"".join(opened(content)) == b"".join(given_pieces)
    assert SealedReader(iter(opened(content))).read() == b"".join(given_pieces)


@given(cut=st.integers(0), pieces=st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=5))
def test_a_file_that_was_cut_off_is_noticed_and_read_up_to_the_last_chunk(
    path: Path, cut: int, pieces: list[bytes]
) -> None:
    content = sealed(path, pieces)
    rest = content[: cut % len(content)]
    found = opened(rest, is_cut=True)
    assert found == pieces[: len(found)]
    length = HEADER_BYTES
    complete = 0
    for piece in pieces:
        length += 4 + len(piece) + 16
        complete += length <= len(rest)
    assert len(found) == complete
    with pytest.raises(SealError):
        opened(rest)


@given(position=st.integers(0), bit=st.integers(0, 7))
def test_a_changed_bit_is_noticed(path: Path, position: int, bit: int) -> None:
    content = bytearray(sealed(path, [b"the first", b"the second"]))
    content[position % len(content)] ^= 1 << bit
    with pytest.raises(SealError):
        opened(bytes(content))


def test_chunks_cannot_be_moved_dropped_or_added(path: Path) -> None:
    content = sealed(path, [b"aaaa", b"bbbb", b"cccc"])
    head, size = content[:HEADER_BYTES], 4 + 4 + 16
    first, second, rest = (
        content[HEADER_BYTES : HEADER_BYTES + size],
        content[HEADER_BYTES + size : HEADER_BYTES + 2 * size],
        content[HEADER_BYTES + 2 * size :],
    )
    for changed in (head + second + first + rest, head + first + rest, content + first):
        with pytest.raises(SealError):
            opened(changed)


def test_another_key_and_another_recording_are_refused(path: Path) -> None:
    content = sealed(path, [b"secret"])
    with pytest.raises(SealError, match="another key"):
        opened(content, key=bytes(32))
    with pytest.raises(SealError):
        opened(content, name="R-2")
    with pytest.raises(SealError, match="no encrypted recording"):
        opened(b"MCAP" * 30)
    assert b"secret" not in content


def test_equal_files_have_different_keys(path: Path) -> None:
    assert sealed(path, [b"same"])[HEADER_BYTES:] != sealed(path, [b"same"])[HEADER_BYTES:]
