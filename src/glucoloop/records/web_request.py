"""One GET over HTTP that ends: its time and its bytes are bounded in all, and its errors are words of our own.

A limit of each operation is not enough: a server may send a byte a second, or ``100 Continue`` for ever. So at the end
of the time the connection is shut down, whatever is waited for. What a library says of an error may quote the request,
with its token; none of it is passed on.
"""

from __future__ import annotations

import contextlib
import functools
import http.client
import os
import re
import socket
import ssl
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from glucoloop.refusal import Refusal

_SILENCE_S: Final = 30.0
_CHUNK: Final = 1 << 16
_HOST: Final = re.compile(r"[0-9A-Za-z]([-_.0-9A-Za-z]*[0-9A-Za-z])?|[0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*")
_PATH: Final = re.compile(r"(/[-._~!$&'()*+,;=:@%0-9A-Za-z]*)*")


class _Address(NamedTuple):
    """Address of a site, each part of which was checked."""

    scheme: str
    host: str
    port: int | None
    path: str

    def text(self, below: str = "") -> str:
        """The address, or one below it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}{'' if self.port is None else f':{self.port}'}{self.path}{below}"


def address_of(text: str, what_else: str) -> _Address:
    """Address of a site from its text; Refusal for any other, and for one with a name, a query or a fragment.

    The refusal ends in `what_else` where the text holds more than the address of a site, which may be a secret; the
    text itself is never a part of it.
    """
    wrong = Refusal("what is given is no address of a site; give one like https://my-site.example")
    try:
        parts = urllib.parse.urlsplit(text)
        port, host = parts.port, parts.hostname or ""
        host = host if host.isascii() else host.encode("idna").decode("ascii")
    except ValueError:  # of a bracket that does not close, a port that is none, and a name that no site can have
        raise wrong from None
    if parts.scheme not in ("http", "https") or not host:
        raise wrong
    if parts.query or parts.fragment or "@" in parts.netloc:
        raise Refusal(f"the address of the site holds more than the address, maybe a token; {what_else}")
    # `urlsplit` drops line ends and tabs in silence.
    if any(letter <= " " for letter in text) or not (_HOST.fullmatch(host) and _PATH.fullmatch(parts.path)):
        raise wrong
    return _Address(parts.scheme, host, port, parts.path.rstrip("/"))


class StatusError(Exception):
    """A status other than 200."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status


@dataclass(kw_only=True)
class Allowance:
    """Time and bytes that all requests together may still take, and those of one."""

    each_s: float = 120.0
    all_s: float = 1800.0
    each_bytes: int = 200_000_000
    all_bytes: int = 2_000_000_000
    _end: float | None = field(default=None, init=False)

    def seconds(self) -> float:
        """Time that the next request may take [s]; the time of all begins with the first."""
        now = time.monotonic()
        self._end = now + self.all_s if self._end is None else self._end
        return min(self.each_s, self._end - now)


def get(address: str, allowance: Allowance, headers: dict[str, str]) -> bytes:
    """Answer to a GET; StatusError for another status than 200, a redirection among them, Refusal as a clause."""
    seconds = allowance.seconds()
    if seconds <= 0.0:
        raise Refusal(f"has not sent everything within {allowance.all_s:g} s; ask for fewer days")
    most = min(allowance.each_bytes, allowance.all_bytes)
    deadline, timed_out = _Deadline(), False
    opener = urllib.request.build_opener(_NoRedirection, _Bounded(deadline), _BoundedTLS(deadline))
    with deadline.after(seconds):
        try:
            request = urllib.request.Request(address, headers=headers, method="GET")
            with opener.open(request, timeout=min(_SILENCE_S, seconds)) as answer:
                data = bytearray()
                while len(data) <= most and (part := answer.read(_CHUNK)):
                    data += part
        except urllib.error.HTTPError as error:
            error.close()
            if not deadline.passed:
                raise StatusError(error.code) from None
        except (OSError, http.client.HTTPException, ValueError) as error:
            # In so short a time the limit of one operation and that of the answer end at the same moment.
            timed_out = seconds <= _SILENCE_S and isinstance(_cause(error), TimeoutError)
            if not (timed_out or deadline.passed):
                raise Refusal(f"gives no answer ({_reason(error)}); check the address and the network") from None
    if timed_out or deadline.passed:
        raise Refusal(f"takes more than {seconds:.3g} s for one answer; try later, or ask for fewer days")
    if len(data) > most:
        raise Refusal(f"answers with more than {most} bytes; ask for fewer days")
    allowance.all_bytes -= len(data)
    return bytes(data)


def _cause(error: BaseException) -> BaseException:
    """The error that one of urllib is about, or the error itself."""
    why = getattr(error, "reason", error)
    return why if isinstance(why, BaseException) else error


def _reason(error: BaseException) -> str:
    """Words of our own, or of the system, for an error of a request."""
    why = _cause(error)
    if isinstance(why, TimeoutError):
        return "the time is over"
    if isinstance(why, socket.gaierror):
        return "its name is not known"
    if isinstance(why, ssl.SSLCertVerificationError):
        return "its certificate is not valid"
    if isinstance(why, ssl.SSLError):
        return "it cannot be encrypted"
    if isinstance(why, ConnectionError | http.client.IncompleteRead) and not isinstance(why, ConnectionRefusedError):
        return "it broke the connection off"
    if isinstance(why, OSError) and why.errno:
        return os.strerror(why.errno)
    return "it does not keep to HTTP"


class _Deadline:
    """Moment at which the connection is shut down, whatever is waited for."""

    def __init__(self) -> None:
        self.passed = False
        self._watched: list[socket.socket] = []
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def after(self, seconds: float) -> Iterator[None]:
        timer = threading.Timer(seconds, self._end)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            with self._lock:
                for watched in self._watched:
                    watched.close()
                self._watched.clear()

    def watch(self, connected: socket.socket) -> None:
        """Shut a connection down at the end; a copy of its number survives its being wrapped in TLS."""
        with self._lock:
            self._watched.append(connected.dup())
        if self.passed:
            self._end()

    def _end(self) -> None:
        self.passed = True
        with self._lock:
            for watched in self._watched:
                with contextlib.suppress(OSError):
                    watched.shutdown(socket.SHUT_RDWR)


class _Connection(http.client.HTTPConnection):
    deadline: _Deadline

    def connect(self) -> None:
        super().connect()
        self.deadline.watch(self.sock)


class _ConnectionTLS(http.client.HTTPSConnection, _Connection):
    """Encrypted `_Connection`, whose `connect` runs before the handshake."""


def _connection(kind: type[_Connection], deadline: _Deadline, *arguments: Any, **options: Any) -> _Connection:
    made = kind(*arguments, **options)
    made.deadline = deadline
    return made


class _Bounded(urllib.request.HTTPHandler):
    def __init__(self, deadline: _Deadline) -> None:
        super().__init__()
        self._made: Any = functools.partial(_connection, _Connection, deadline)

    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(self._made, req)


class _BoundedTLS(urllib.request.HTTPSHandler):
    def __init__(self, deadline: _Deadline) -> None:
        super().__init__()
        self._made: Any = functools.partial(_connection, _ConnectionTLS, deadline)

    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(self._made, req, context=ssl.create_default_context())


class _NoRedirection(urllib.request.HTTPRedirectHandler):
    """A token must not follow where a site points to."""

    def redirect_request(self, *_: Any) -> None:
        return None
