"""TLS of a real server: certificates that change, expire or are wrong, and clients that do not finish."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from websockets.asyncio.client import connect

from handover.errors import UsageError
from handover.http.protocol import Connections, HttpProtocol
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.network.tls_trust import AuthorityUnreadable, client_context, handshake_fault
from handover.serving.certificate_watch import CertificateWatch
from handover.serving.server import Server
from handover.settings import Settings
from handover.transport_security.local_authority import ServerFiles
from handover.transport_security.server_certificate import CertificateInvalid, ServerCertificate
from handover.transport_security.tls_listener import HANDSHAKES, listen
from tests.kit.certificates import Certificates, serial_in, serial_of
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

REQUEST = b"GET /x HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.fixture
def certificates(tmp_path: Path) -> Certificates:
    return Certificates(tmp_path)


async def answer(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the scheme; echo one text on a WebSocket."""
    if scope["type"] == "lifespan":
        await receive()
        await send({"type": "lifespan.startup.complete"})
        await receive()
        await send({"type": "lifespan.shutdown.complete"})
    elif scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        message = await receive()
        await send({"type": "websocket.send", "text": message["text"]})
        await send({"type": "websocket.close"})
    else:
        body = scope["scheme"].encode()
        headers = [(b"content-length", b"%d" % len(body))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


class _Server:
    def __init__(self, port: int, certificate: ServerCertificate) -> None:
        self.port = port
        self.certificate = certificate
        self.url = f"https://localhost:{port}/"


@asynccontextmanager
async def serving(files: ServerFiles, **more: Any) -> AsyncIterator[_Server]:
    """Run the server of our services, with the protocol that they have."""
    settings = Settings.load(
        tls_certificate=files.certificate, tls_key=files.key, broker_url="http://127.0.0.1:9", **more
    )
    certificate = ServerCertificate.of(settings)
    assert certificate is not None
    port = next_free_port()
    connections = Connections(settings)

    def protocol(**given: object) -> HttpProtocol:
        return HttpProtocol(**given, connections=connections)  # type: ignore[arg-type]

    config = uvicorn.Config(
        answer, host="127.0.0.1", port=port, log_config=None, http=protocol, timeout_graceful_shutdown=1
    )
    server = Server(config, settings, certificate, CertificateWatch(certificate, settings, "lamp"))
    running = asyncio.create_task(server.serve())
    try:
        await until(lambda: server.started and server.servers)
        yield _Server(port, certificate)
    finally:
        server.should_exit = True
        await running


async def connected(
    port: int, files: ServerFiles, name: str = "localhost"
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection(
        "127.0.0.1", port, ssl=client_context(files.authority), server_hostname=name
    )


async def asked(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
    writer.write(REQUEST)
    head = await reader.readuntil(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200")
    return await reader.readexactly(5)


def shown_by(writer: asyncio.StreamWriter) -> int:
    return serial_of(writer.get_extra_info("ssl_object").getpeercert(binary_form=True))


async def test_requests_and_websockets_over_tls(certificates: Certificates) -> None:
    files = certificates.make()
    async with serving(files) as server:
        context = client_context(files.authority)
        async with httpx.AsyncClient(verify=context, trust_env=False) as client:
            assert (await client.get(server.url)).text == "https"
            assert (await client.get(f"https://127.0.0.1:{server.port}/")).text == "https"
        async with connect(f"wss://localhost:{server.port}/", ssl=context, proxy=None) as opened:
            await opened.send("hello")
            assert await opened.recv() == "hello"
        ours = BodyReadingHttpClient(ca_files=(files.authority,))
        assert (await ours.request("GET", server.url, [], b"", 60)).body == b"https"
        ours.close()


async def test_old_versions_of_tls_are_refused(certificates: Certificates) -> None:
    files = certificates.make()
    async with serving(files) as server:
        old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        old.load_verify_locations(files.authority)
        old.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1"):
            old.minimum_version = ssl.TLSVersion.TLSv1
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await asyncio.open_connection("127.0.0.1", server.port, ssl=old, server_hostname="localhost")
        new = ssl.create_default_context(cafile=files.authority)
        new.maximum_version = ssl.TLSVersion.TLSv1_2
        _, writer = await asyncio.open_connection(
            "127.0.0.1", server.port, ssl=new, server_hostname="localhost"
        )
        assert writer.get_extra_info("cipher")[0].startswith("ECDHE")
        writer.close()


@pytest.mark.nightly
async def test_a_new_certificate_serves_new_connections_and_open_ones_continue(
    certificates: Certificates,
) -> None:
    files = certificates.make()
    before = serial_in(files.certificate)
    async with serving(files) as server:
        reader, writer = await connected(server.port, files)
        assert await asked(reader, writer) == b"https"
        certificates.authority.renew()
        after = serial_in(files.certificate)
        assert after != before

        async def new_connection_shows_it() -> bool:
            _, other = await connected(server.port, files)
            other.close()
            return shown_by(other) == after

        await until(new_connection_shows_it)
        assert await asked(reader, writer) == b"https", "the open connection continues"
        assert shown_by(writer) == before
        writer.close()


async def test_a_broken_new_certificate_changes_nothing(certificates: Certificates) -> None:
    files = certificates.make()
    before = serial_in(files.certificate)
    good = files.certificate.read_bytes()
    async with serving(files) as server:
        for broken in (b"rubbish", certificates.make(server="other").certificate.read_bytes(), None):
            if broken is None:
                files.certificate.unlink()
            else:
                files.certificate.write_bytes(broken)
            with pytest.raises(CertificateInvalid, match=str(files.certificate)):
                server.certificate.reload()
            _, writer = await connected(server.port, files)
            assert shown_by(writer) == before
            writer.close()
        files.certificate.write_bytes(good)
        assert server.certificate.reload()


def test_an_expired_certificate_stops_the_start_and_names_the_way_out(certificates: Certificates) -> None:
    files = certificates.make(expires_in=timedelta(days=-2))
    with pytest.raises(CertificateInvalid, match=r"expired on .* `handover secure renew`"):
        ServerCertificate(files.certificate, files.key)


def test_certificate_and_key_may_be_in_one_file_and_must_belong_together(certificates: Certificates) -> None:
    files, other = certificates.make(), certificates.make(server="other")
    both = certificates.folder / "both.pem"
    both.write_bytes(files.certificate.read_bytes() + files.key.read_bytes())
    assert ServerCertificate(both).expires == files.expires
    with pytest.raises(CertificateInvalid, match="key values mismatch"):
        ServerCertificate(files.certificate, other.key)
    with pytest.raises(CertificateInvalid, match="cannot be read: No such file"):
        ServerCertificate(files.certificate, certificates.folder / "none.pem")


def test_an_encrypted_key_is_refused_instead_of_asking_for_its_password(certificates: Certificates) -> None:
    from cryptography.hazmat.primitives import serialization as pem

    files = certificates.make()
    key = pem.load_pem_private_key(files.key.read_bytes(), None)
    encrypted = pem.BestAvailableEncryption(b"secret")
    files.key.write_bytes(key.private_bytes(pem.Encoding.PEM, pem.PrivateFormat.PKCS8, encrypted))
    with pytest.raises(CertificateInvalid, match="is encrypted"):
        ServerCertificate(files.certificate, files.key)


@pytest.mark.nightly
async def test_clients_name_the_fault_of_the_certificate(certificates: Certificates, tmp_path: Path) -> None:
    files = certificates.make("cell-3.example")
    stranger = Certificates(tmp_path / "stranger").make()

    async def fault(url: str, authority: Path) -> str:
        ours = BodyReadingHttpClient(ca_files=(authority,))
        with pytest.raises(SendError) as ours_failed:
            await ours.request("GET", url, [], b"", 60)
        async with httpx.AsyncClient(verify=client_context(authority), trust_env=False) as client:
            with pytest.raises(httpx.ConnectError) as theirs_failed:
                await client.get(url)
        found = handshake_fault(theirs_failed.value, url.removeprefix("https://").strip("/"))
        assert found == str(ours_failed.value)
        return found

    port = next_free_port()
    anywhere = await listen(
        asyncio.Protocol, "0.0.0.0", port, ServerCertificate(files.certificate, files.key)
    )
    wrong = await fault(f"https://localhost:{port}", stranger.authority)
    assert "from an authority that is not trusted here; set HANDOVER_TLS_AUTHORITY" in wrong
    wrong = await fault(f"https://127.0.0.2:{port}", files.authority)
    assert "is for other names; use a name that it has" in wrong
    with pytest.raises(ssl.SSLCertVerificationError) as other_name:
        await connected(port, files, "cell-4.example")
    named = handshake_fault(other_name.value, "cell-4.example")
    assert named is not None
    assert named.startswith("the certificate of cell-4.example is for other names")
    anywhere.close()
    await anywhere.wait_closed()

    files = certificates.make(server="expired", expires_in=timedelta(seconds=3))
    certificate = ServerCertificate(files.certificate, files.key)
    port = next_free_port()
    listener = await listen(asyncio.Protocol, "127.0.0.1", port, certificate)
    context = client_context(files.authority)

    async def has_expired() -> bool:
        try:
            _, writer = await asyncio.open_connection(
                "127.0.0.1", port, ssl=context, server_hostname="localhost"
            )
        except ssl.SSLCertVerificationError:
            return True
        writer.close()
        return False

    await until(has_expired)
    assert "has expired; renew it there: handover secure renew" in await fault(
        f"https://localhost:{port}/", files.authority
    )
    listener.close()
    await listener.wait_closed()


async def test_a_client_of_tls_names_a_server_without_it(certificates: Certificates) -> None:
    files = certificates.make()

    class Plain(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            self.transport: Any = transport

        def data_received(self, data: bytes) -> None:
            self.transport.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            self.transport.close()

    port = next_free_port()
    listener = await listen(Plain, "127.0.0.1", port, None)
    client = BodyReadingHttpClient(ca_files=(files.authority,))
    with pytest.raises(SendError, match="does not speak TLS; use http://"):
        await client.request("GET", f"https://localhost:{port}/", [], b"", 60)
    listener.close()


def test_a_missing_authority_is_named() -> None:
    with pytest.raises(AuthorityUnreadable, match=r"/none.pem cannot be read.*set HANDOVER_TLS_AUTHORITY"):
        client_context(Path("/none.pem"))


async def test_a_handshake_that_does_not_continue_is_ended(certificates: Certificates) -> None:
    async with serving(certificates.make(), tls_handshake_timeout_s=0.2) as server:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(b"\x16\x03\x01")
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()


async def test_pending_handshakes_are_bounded_and_those_of_others_continue(
    certificates: Certificates,
) -> None:
    files = certificates.make()
    certificate = ServerCertificate(files.certificate, files.key)
    port = next_free_port()
    echoed: list[bytes] = []

    class Echo(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            self.transport = transport

        def data_received(self, data: bytes) -> None:
            echoed.append(data)

    listener = await listen(Echo, "0.0.0.0", port, certificate, max_pending=4, handshake_timeout_s=600)
    ended = HANDSHAKES.labels("too many")._value
    before = ended.get()

    async def slow(address: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0))

    other = await slow("127.0.0.3")
    many = [await slow("127.0.0.2") for _ in range(8)]
    await until(lambda: ended.get() == before + 5)
    for reader, _ in many[:5]:
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b"", "the oldest of the address with most are ended"
    _, writer = await connected(port, files)
    writer.write(b"data right after the handshake")
    await until(lambda: b"".join(echoed) == b"data right after the handshake")
    assert not other[0].at_eof()
    for _, one in (*many, other, (None, writer)):
        one.close()
    listener.close()
    await listener.wait_closed()


async def test_data_sent_with_the_last_message_of_the_handshake_arrives(certificates: Certificates) -> None:
    """A client whose first data arrives together with the end of its handshake loses nothing."""
    files = certificates.make()
    async with serving(files) as server:
        incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        client = client_context(files.authority).wrap_bio(incoming, outgoing, server_hostname="localhost")
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        while True:
            try:
                client.do_handshake()
                break
            except ssl.SSLWantReadError:
                writer.write(outgoing.read())
                incoming.write(await reader.read(65536))
        client.write(REQUEST)
        writer.write(outgoing.read())
        received = b""
        while not received.endswith(b"https"):
            incoming.write(await reader.read(65536))
            with contextlib.suppress(ssl.SSLWantReadError):
                while True:
                    received += client.read()
        assert received.startswith(b"HTTP/1.1 200")
        writer.close()


def test_settings_of_tls() -> None:
    secured = Settings.load(tls_certificate="c.pem")
    assert secured.url_of(54400) == "https://127.0.0.1:54400"
    assert secured.broker_url == "https://127.0.0.1:1026"
    assert (
        Settings.load(tls_certificate="c.pem", broker_url="http://orion:1026").broker_url
        == "http://orion:1026"
    )
    with pytest.raises(UsageError, match="tls_key is set without tls_certificate"):
        Settings.load(tls_key="k.pem")
    with pytest.raises(UsageError, match="is no https address"):
        Settings.load(tls_proxy_url="http://cell-3.example")


def test_uvicorn_has_what_the_tls_server_overrides() -> None:
    assert {"startup", "shutdown", "serve"} <= set(dir(uvicorn.Server))
    assert "sockets" in uvicorn.Server.startup.__annotations__


async def test_the_certificate_of_a_public_authority_is_for_its_names_and_the_cell_keeps_its_own(
    certificates: Certificates, tmp_path: Path
) -> None:
    own = certificates.make("localhost", "127.0.0.1", "webui")
    public = Certificates(tmp_path / "public").make("cell-3.example", "*.line.example")
    async with serving(own, public_tls_certificate=public.certificate, public_tls_key=public.key) as server:

        async def shown_to(name: str) -> int:
            context = ssl.create_default_context()
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            _, writer = await asyncio.open_connection(
                "localhost", server.port, ssl=context, server_hostname=name
            )
            der = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
            writer.close()
            with contextlib.suppress(OSError, ssl.SSLError):
                await writer.wait_closed()
            return serial_of(der)

        for name in ("cell-3.example", "CELL-3.example", "a.line.example"):
            assert await shown_to(name) == serial_in(public.certificate)
        for name in ("webui", "localhost", "127.0.0.1", "b.a.line.example", "line.example", "other.example"):
            assert await shown_to(name) == serial_in(own.certificate)
        renewed = Certificates(tmp_path / "public").make("cell-3.example")
        assert server.certificate.reload()
        assert await shown_to("cell-3.example") == serial_in(renewed.certificate)
        assert await shown_to("a.line.example") == serial_in(own.certificate)


def test_a_public_certificate_alone_is_refused_with_the_way_out(certificates: Certificates) -> None:
    files = certificates.make("cell-3.example")
    with pytest.raises(UsageError, match="public_tls_certificate is set without tls_certificate"):
        Settings.load(public_tls_certificate=files.certificate)
