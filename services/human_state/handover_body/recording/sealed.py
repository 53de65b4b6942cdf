"""Encrypted files that are written chunk by chunk.

    magic (8) | key id (8) | salt (32) | length (4) ciphertext | length (4) ciphertext | ...

Each file has a key of its own: HKDF-SHA256 (RFC 5869) of the key of the setting and a random salt. A chunk is
AES-256-GCM with the number of the chunk and a mark of the last one as nonce, so chunks can be neither
reordered nor dropped, and a file cannot be cut off unnoticed (the STREAM construction of Hoang, Reyhanitabar,
Rogaway and Vizar, CRYPTO 2015). The additional data are the header and the name of the recording, so no file
passes for another.

A chunk is on the disk when `seal` returns. After a crash everything up to the last complete chunk can be read
with `is_cut`.
"""

import hashlib
import hmac
import os
import struct
from collections.abc import Iterator
from io import RawIOBase
from typing import IO, Any, Final

from handover.errors import HandoverError

MAGIC: Final = b"HNDREC1\n"
CHUNK_BYTES: Final = 64 * 1024
KEY_BYTES: Final = 32
MAX_CHUNK_BYTES: Final = 16 * 2**20
_TAG_BYTES: Final = 16
_ID_BYTES: Final = 8
_SALT_BYTES: Final = 32
_HEAD_BYTES: Final = len(MAGIC) + _ID_BYTES + _SALT_BYTES
_LENGTH: Final = struct.Struct(">I")


class SealError(HandoverError):
    """An encrypted file cannot be read: another key, changed, or cut off."""


class SealedWriter:
    """Encrypts what is written to `file`. Not thread-safe; `file` stays open after `close`."""

    def __init__(self, file: IO[bytes], key: bytes, name: str) -> None:
        salt = os.urandom(_SALT_BYTES)
        header = MAGIC + _key_id(key) + salt
        self._file = file
        self._cipher = _cipher(key, salt)
        self._additional = header + name.encode()
        self._buffer = bytearray()
        self._chunks = 0
        self._digest = hashlib.sha256()
        self._size = 0
        file.write(header)

    @property
    def sha256(self) -> str:
        """The SHA-256 of what was written, before encryption, in hexadecimal digits."""
        return self._digest.hexdigest()

    def write(self, data: bytes) -> int:
        """Add bytes; they are on the disk after `seal`."""
        self._digest.update(data)
        self._size += len(data)
        self._buffer += data
        while len(self._buffer) > CHUNK_BYTES:
            self._write_chunk(CHUNK_BYTES, is_last=False)
        return len(data)

    def tell(self) -> int:
        """Return how many bytes were written, before encryption."""
        return self._size

    def flush(self) -> None:
        """Do nothing: `seal` is for what must be on the disk."""

    def seal(self) -> None:
        """Write the bytes that wait as a chunk, to the disk. Raises `OSError`."""
        if self._buffer:
            self._write_chunk(len(self._buffer), is_last=False)
        _sync(self._file)

    def close(self) -> None:
        """Write the last chunk, to the disk. Raises `OSError`."""
        self._write_chunk(len(self._buffer), is_last=True)
        _sync(self._file)

    def _write_chunk(self, length: int, *, is_last: bool) -> None:
        nonce = _nonce(self._chunks, is_last=is_last)
        sealed = self._cipher.encrypt(nonce, bytes(self._buffer[:length]), self._additional)
        del self._buffer[:length]
        self._chunks += 1
        self._file.write(_LENGTH.pack(len(sealed)) + sealed)


def chunks_of(file: IO[bytes], key: bytes, name: str, *, is_cut: bool = False) -> Iterator[bytes]:
    """Yield the decrypted chunks. Raises `SealError`, unless `is_cut`, also where the file ends too early.

    With `is_cut` the chunks end at the first one that is not complete.
    """
    header = file.read(_HEAD_BYTES)
    if len(header) < _HEAD_BYTES or not header.startswith(MAGIC):
        if is_cut and MAGIC.startswith(header[: len(MAGIC)]):
            return
        raise SealError(f"{name} is no encrypted recording; was its file replaced?")
    if not hmac.compare_digest(header[len(MAGIC) : -_SALT_BYTES], _key_id(key)):
        raise SealError(
            f"{name} was recorded with another key; set HANDOVER_HEALTH_RECORDING_KEY to the one of that time"
        )
    cipher, additional = _cipher(key, header[-_SALT_BYTES:]), header + name.encode()
    number, is_last = 0, False
    while not is_last:
        sealed = _next(file)
        opened = None if sealed is None else _opened(cipher, sealed, number, additional)
        if opened is None:
            if is_cut:
                return
            raise SealError(f"{name} was changed or cut off; its file cannot be trusted")
        data, is_last = opened
        number += 1
        yield data
    if file.read(1):
        raise SealError(f"{name} has bytes after its end; its file was changed")


class SealedReader(RawIOBase):
    """The decrypted bytes as a file that is read once."""

    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._rest = memoryview(b"")

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill `buffer` with the next bytes, and return how many; 0 at the end."""
        while not self._rest:
            chunk = next(self._chunks, None)
            if chunk is None:
                return 0
            self._rest = memoryview(chunk)
        taken = min(len(buffer), len(self._rest))
        buffer[:taken] = self._rest[:taken]
        self._rest = self._rest[taken:]
        return taken


def _next(file: IO[bytes]) -> bytes | None:
    head = file.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    length = _LENGTH.unpack(head)[0]
    if not _TAG_BYTES <= length <= MAX_CHUNK_BYTES:
        return None
    sealed = file.read(length)
    return sealed if len(sealed) == length else None


def _opened(cipher: Any, sealed: bytes, number: int, additional: bytes) -> tuple[bytes, bool] | None:
    from cryptography.exceptions import InvalidTag  # noqa: PLC0415 - only where something is recorded

    for is_last in (False, True):
        try:
            return cipher.decrypt(_nonce(number, is_last=is_last), sealed, additional), is_last
        except InvalidTag:
            continue
    return None


def _nonce(number: int, *, is_last: bool) -> bytes:
    return number.to_bytes(11, "big") + bytes([is_last])


def _cipher(key: bytes, salt: bytes) -> Any:
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM  # noqa: PLC0415 - as above

    return AESGCM(_derived(key, salt, b"handover recording", KEY_BYTES))


def _key_id(key: bytes) -> bytes:
    return _derived(key, b"", b"handover recording key id", _ID_BYTES)


def _derived(key: bytes, salt: bytes, info: bytes, length: int) -> bytes:
    from cryptography.hazmat.primitives.hashes import SHA256  # noqa: PLC0415 - as above
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF  # noqa: PLC0415 - as above

    return HKDF(SHA256(), length, salt or None, info).derive(key)


def _sync(file: IO[bytes]) -> None:
    file.flush()
    os.fsync(file.fileno())
