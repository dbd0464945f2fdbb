"""A guard in front of a WebSocket server that does not check the origin of pages.

Foxglove's SDK does not check the origin of a connection, so any page in a browser could read a
robot's topics. The guard reads the request that opens a connection, refuses pages of other
sites, and then forwards bytes unchanged. The guarded server uses TLS with a certificate that only
the guard knows, so no browser can bypass the guard.
"""

import asyncio
import contextlib
import datetime
import ipaddress
import socket
import ssl
import threading
from email.parser import BytesParser
from typing import NamedTuple, Self
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from oracle_pipeline.live.loopback import HOST
from oracle_pipeline.web_guard import is_loopback

_LONGEST = 16_384  # bytes of a request
_REQUEST_S = 5.0  # until a request must be complete
_PIECE = 65_536  # bytes that are forwarded at once
_REFUSAL = "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class Certificate(NamedTuple):
    """A certificate for this machine, and its key; PEM."""

    certificate: bytes
    key: bytes


def certificate() -> Certificate:
    """Return a new self-signed certificate."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "oracle watch")])
    now = datetime.datetime.now(datetime.UTC)
    signed = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=3650))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address(HOST))]),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    return Certificate(
        signed.public_bytes(serialization.Encoding.PEM),
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
    )


class HandshakeGuard:
    """Listens on this machine, and forwards accepted connections; a context manager.

    Parameters
    ----------
    listening : socket
        Bound to an address of this machine.
    port : int
        Of the guarded server, on 127.0.0.1.
    trusted : Certificate
        Certificate of that server.
    origins : tuple of str
        Sites whose pages may connect, beside those of this machine.
    """

    def __init__(
        self,
        listening: socket.socket,
        port: int,
        trusted: Certificate,
        origins: tuple[str, ...] = (),
    ) -> None:
        self._listening, self._port, self._origins = listening, port, origins
        self._tls = ssl.create_default_context(cadata=trusted.certificate.decode())
        self._loop = asyncio.new_event_loop()
        self._is_over = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="handshakes", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self._loop.call_soon_threadsafe(self._is_over.set)
        self._thread.join()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        """Accept connections until the end; then `asyncio.Runner` cancels the open ones."""
        listening = await asyncio.start_server(
            self._connection, sock=self._listening, limit=_LONGEST
        )
        await self._is_over.wait()
        listening.close()

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.closing(writer), contextlib.suppress(OSError, asyncio.CancelledError):
            try:
                request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_S)
            except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
                return
            if refusal := self.refusal(request):
                writer.write(_REFUSAL.format(status=refusal).encode())
                await writer.drain()
                return
            server_reader, server_writer = await asyncio.open_connection(
                HOST, self._port, ssl=self._tls
            )
            with contextlib.closing(server_writer):
                server_writer.write(request)
                ways = (_forward(reader, server_writer), _forward(server_reader, writer))
                tasks = [asyncio.ensure_future(way) for way in ways]
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in tasks:
                    task.cancel()

    def refusal(self, request: bytes) -> str | None:
        """Return the status line of a refusal, or None to accept the request."""
        headers = BytesParser().parsebytes(request.partition(b"\r\n")[2], headersonly=True)
        if any(len(headers.get_all(name, [])) > 1 for name in ("Host", "Origin")):
            return "400 Bad Request"
        host, origin = str(headers.get("Host", "")).lower(), headers.get("Origin")
        if not is_loopback(host):  # DNS rebinding: a foreign name that resolves to this machine
            return "403 Forbidden"
        if origin is None or self._may_connect(str(origin).lower()):
            return None
        return "403 Forbidden"

    def _may_connect(self, origin: str) -> bool:
        """Return whether an origin is listed, of this machine, or of an application's scheme."""
        parts = urlsplit(origin)
        if parts.scheme in ("http", "https"):
            return origin in self._origins or is_loopback(parts.netloc)
        return origin != "null"  # the opaque origin, such as that of a sandboxed frame


async def _forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while piece := await reader.read(_PIECE):
        writer.write(piece)
        await writer.drain()
