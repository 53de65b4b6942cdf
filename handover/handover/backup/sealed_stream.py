"""The encryption of a backup: a stream in chunks, with a key from a passphrase.

    magic (20 bytes) | salt (16) | prefix (7) | chunk | chunk | … | last chunk

The key is that of scrypt (RFC 7914; N = 2^16, r = 8, p = 1: 64 MiB of memory for each guess). A chunk is
AES-256-GCM of 1 MiB at most. Its nonce is the random prefix, the number of the chunk (4 bytes) and whether it
is the last one (1 byte), as in the STREAM construction (Hoang, Reyhanitabar, Rogaway and Vizár, CRYPTO 2015):
chunks cannot be left out, exchanged or cut off. The header is authenticated with each chunk.
"""

import io
import secrets
from typing import BinaryIO, Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from handover.errors import UsageError

MAGIC: Final = b"handover-sealed-1\r\n\0"
CHUNK_BYTES: Final = 1024 * 1024
_SALT_BYTES, _PREFIX_BYTES, _TAG_BYTES = 16, 7, 16
_HEADER_BYTES: Final = len(MAGIC) + _SALT_BYTES + _PREFIX_BYTES
_SCRYPT_N: Final = 2**16
_MAX_CHUNKS: Final = 2**32
CUT: Final = "the backup ends too early: it was cut off or damaged; use another copy"


def is_sealed(file: BinaryIO) -> bool:
    """Return whether a file, which is at its beginning, is encrypted; it stays at its beginning."""
    beginning = file.read(len(MAGIC))
    file.seek(0)
    return beginning == MAGIC


class SealedWriter(io.RawIOBase):
    """Encrypts into `target` what is written to it; `close` writes the last chunk, `target` stays open."""

    def __init__(self, target: BinaryIO, passphrase: str) -> None:
        self._target = target
        self._header = MAGIC + secrets.token_bytes(_SALT_BYTES + _PREFIX_BYTES)
        self._cipher = _cipher(self._header, passphrase)
        self._waiting = bytearray()
        self._number = 0
        target.write(self._header)

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, content: "io.ReadableBuffer") -> int:  # type: ignore[name-defined]
        """Encrypt `content`; the last chunk waits, since only `close` makes it the last one."""
        view = memoryview(content)
        self._waiting += view
        while len(self._waiting) > CHUNK_BYTES:
            self._seal(bytes(self._waiting[:CHUNK_BYTES]), is_last=False)
            del self._waiting[:CHUNK_BYTES]
        return view.nbytes

    def close(self) -> None:
        """Write the last chunk."""
        if not self.closed:
            self._seal(bytes(self._waiting), is_last=True)
        super().close()

    def _seal(self, plain: bytes, *, is_last: bool) -> None:
        nonce = _nonce(self._header, self._number, is_last=is_last)
        self._target.write(self._cipher.encrypt(nonce, plain, self._header))
        self._number += 1


class SealedReader(io.RawIOBase):
    """Decrypts `source`. Raises `UsageError` for a wrong passphrase, or if it was changed or cut off."""

    def __init__(self, source: BinaryIO, passphrase: str) -> None:
        self._source = source
        self._header = source.read(_HEADER_BYTES)
        self._cipher = _cipher(self._header, passphrase)
        self._next = source.read(CHUNK_BYTES + _TAG_BYTES)
        self._plain = memoryview(b"")
        self._number = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, target: "io.WriteableBuffer") -> int:  # type: ignore[name-defined]
        """Read what is left of the present chunk, or the next one."""
        while not self._plain and self._next:
            self._open_next()
        view = memoryview(target).cast("B")
        part = self._plain[: len(view)]
        view[: len(part)] = part
        self._plain = self._plain[len(part) :]
        return len(part)

    def _open_next(self) -> None:
        sealed, self._next = self._next, self._source.read(CHUNK_BYTES + _TAG_BYTES)
        nonce = _nonce(self._header, self._number, is_last=not self._next)
        try:
            self._plain = memoryview(self._cipher.decrypt(nonce, sealed, self._header))
        except InvalidTag:
            if not self._number and self._next:
                raise UsageError(
                    "the passphrase is wrong, or the backup is damaged at its beginning"
                ) from None
            if not self._number:
                raise UsageError("the passphrase is wrong, or the backup was cut off or damaged") from None
            raise UsageError(CUT) from None
        self._number += 1


def _cipher(header: bytes, passphrase: str) -> AESGCM:
    if len(header) != _HEADER_BYTES:
        raise UsageError(CUT)
    salt = header[len(MAGIC) : len(MAGIC) + _SALT_BYTES]
    return AESGCM(Scrypt(salt, length=32, n=_SCRYPT_N, r=8, p=1).derive(passphrase.encode()))


def _nonce(header: bytes, number: int, *, is_last: bool) -> bytes:
    if number >= _MAX_CHUNKS:
        raise UsageError("the backup has more than 4 PB; delete recordings first")
    return header[-_PREFIX_BYTES:] + number.to_bytes(4, "big") + bytes([is_last])
