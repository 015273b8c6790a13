"""The server of the page: on this machine only, for whoever knows the token, for the page's own requests.

The page asks for fixed names only, so that no path of a request ever reaches the disk.
"""

import hmac
import json
import logging
import math
import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from socketserver import TCPServer
from threading import Condition
from typing import Any

from contactimg.errors import ContactimgError, InputError
from contactimg.review.frame_view import LIGHT_TOP
from contactimg.review.jobs import SECONDS
from contactimg.review.session import TABLES, Session
from contactimg.tables import EDITS, Flag
from contactimg.tables.outlines import KINDS_OF_CONTACTS, REJECTED_KIND

logger = logging.getLogger(__name__)

ADDRESS = "127.0.0.1"
LARGEST_BODY = 2**20
"""Most bytes of a request. Chosen: a mask of 10,000 corners."""
PAGE_FILES = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
}
"""Last part of the address -> file of this package and its type."""
_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class ReviewServer(ThreadingHTTPServer):
    """Serves the page of a session under an address that holds a random token.

    Parameters
    ----------
    session : Session
    port : int
        0 for any that is free.

    Notes
    -----
    It listens on 127.0.0.1. A request must name this machine as its host (else a foreign page could have its
    own name resolved to 127.0.0.1), and one that writes must come from the page itself (``Origin``). Any port
    of this machine is accepted in both, for a forwarded one may differ. Headers such as ``X-Forwarded-Host``
    are not believed, for any page can have them sent.
    """

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # elsewhere it would let another program take the port

    def __init__(self, session: Session, port: int = 0) -> None:
        super().__init__((ADDRESS, port), _Handler)
        self.session, self.token = session, secrets.token_urlsafe(24)
        self._idle, self._answering, self._closed = Condition(), 0, False

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{ADDRESS}:{self.server_address[1]}/{self.token}/"

    def server_bind(self) -> None:
        """Bind without looking up the name of this machine, which may take seconds."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = ADDRESS, self.server_address[1]

    @contextmanager
    def answering(self) -> Iterator[bool]:
        """Count a request while it is answered; the context is False if the server is being closed."""
        with self._idle:
            self._answering += 1
        try:
            yield not self._closed
        finally:
            with self._idle:
                self._answering -= 1
                self._idle.notify_all()

    def server_close(self) -> None:
        """Wait for the answers that are being made: code that is not Python must not be cut short."""
        self._closed = True
        super().server_close()
        with self._idle:
            self._idle.wait_for(lambda: not self._answering, SECONDS)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """A connection that broke is no error of the server's."""
        logger.info("a request of %s ended early", client_address, exc_info=True)


class RefusedError(Exception):
    """A request is not answered; ``status`` is that of HTTP."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "contactimg"
    sys_version = ""
    timeout = SECONDS
    server: ReviewServer

    def do_GET(self) -> None:
        """Answer a request that changes nothing."""
        self._answer(lambda: answer_get(self.server.session, self._admitted_path()))

    def do_POST(self) -> None:
        """Answer a request that changes something."""
        self._answer(self._posted)

    def _posted(self) -> "Answer":
        length = self.headers.get("Content-Length", "")
        if not length.isascii() or not length.isdigit() or int(length) > LARGEST_BODY:
            self.close_connection = True
            raise RefusedError(413, f"a request must have a body of at most {LARGEST_BODY} bytes")
        body, path = self.rfile.read(int(length)), self._admitted_path()
        kind, host = self.headers.get("Content-Type", "").split(";")[0].strip(), self.headers.get("Host", "")
        if self.headers.get("Origin", "") != f"http://{host}" or kind != "application/json":
            raise RefusedError(403, "the request does not come from the page")
        try:
            data = json.loads(body)
            if not isinstance(data, dict):
                raise TypeError
        except (ValueError, TypeError, RecursionError):
            raise RefusedError(400, "the request is not JSON") from None
        return answer_post(self.server.session, path, data)

    def _admitted_path(self) -> str:
        """The path after the token, of a request from the page."""
        if not _HOST.fullmatch(self.headers.get("Host", "")):
            raise RefusedError(421, "the host of the address must be this machine")
        if self.headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
            raise RefusedError(403, "the request comes from another page")
        _, token, *rest = [*self.path.split("?")[0].split("/", 2), ""][:3]
        if not hmac.compare_digest(token.encode(), self.server.token.encode()) or self.path.count("/") < 2:
            raise RefusedError(404, "there is no such page; use the whole address that the command printed")
        return rest[0]

    def _answer(self, make: Callable[[], "Answer"]) -> None:
        """Send what ``make`` returns, or why there is no answer."""
        try:
            with self.server.answering() as is_open:
                self.close_connection |= not is_open
                if not is_open:
                    raise RefusedError(503, "the review is being ended")
                answer = make()
        except RefusedError as error:
            answer = Answer.of({"error": str(error)}, error.status)
        except ContactimgError as error:
            answer = Answer.of({"error": str(error)}, 400)
        except Exception as error:
            logger.exception("%s", self.path.rpartition("/")[2])
            answer = Answer.of({"error": f"{type(error).__name__}: {error}"}, 500)
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(len(answer.body)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(answer.body)

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Nothing is logged, for the address holds the token."""


# --- what the page may ask for


@dataclass(frozen=True)
class Answer:
    """The body of an answer."""

    body: bytes
    kind: str = "application/json"
    status: int = 200

    @classmethod
    def of(cls, data: Any, status: int = 200) -> "Answer":
        """Make an answer of data, as JSON."""
        return cls(json.dumps(data, allow_nan=False).encode(), status=status)


def answer_get(session: Session, path: str) -> Answer:
    """The answer to a request that changes nothing.

    Parameters
    ----------
    session : Session
    path : str
        Part of the address after the token.

    Raises
    ------
    RefusedError
        If there is no such thing.
    """
    if path in PAGE_FILES:
        name, kind = PAGE_FILES[path]
        return Answer(files("contactimg.review").joinpath(name).read_bytes(), kind)
    if path == "job.json":
        return Answer.of(vars(session.jobs.state))
    if path == "run.json":
        fixed = {
            "kinds": [kind.record for kind in KINDS_OF_CONTACTS],
            "rejected": REJECTED_KIND.record,
            "flags": {str(flag.name): int(flag) for flag in Flag},
            "light_top": LIGHT_TOP,
        }
        return Answer.of(session.record() | fixed)
    table = re.fullmatch(r"tables/([a-z]+)\.csv", path)
    if table is not None and table[1] in TABLES:
        return Answer(session.shown.text(table[1]), "text/csv; charset=utf-8")
    makers: dict[str, Callable[[int], Any]] = {
        "image": session.picture,
        "light": session.light_picture,
        "contacts": session.contacts,
        "curves": session.curves,
    }
    asked = rf"frames/(\d{{1,7}})/(?:contact/(\d{{1,9}})|({'|'.join(makers)}))\.(?:json|png)"
    match = re.fullmatch(asked, path)
    if match is None or int(match[1]) >= len(session.sources):
        raise RefusedError(404, "there is no such thing")
    number, label, what = int(match[1]), match[2], match[3]
    found = makers[what](number) if label is None else session.window(number, int(label))
    return Answer(found, "image/png") if isinstance(found, bytes) else Answer.of(found)


def answer_post(session: Session, path: str, data: dict[str, Any]) -> Answer:
    """The answer to a request that changes something; what it changes is on the disk by then.

    Raises
    ------
    InputError, RefusedError
        If the request is not valid.
    """
    if path == "edits/insert":
        rows, place = data.get("rows"), data.get("place")
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise InputError("rows must be a list of edits")
        edits = [_edit(row) for row in rows]
        for edit in edits:  # what a person writes has no line breaks
            edit |= {name: " ".join(edit[name].split()) for name in ("author", "reason")}
        session.insert(edits, place if isinstance(place, int) else None)
    elif path == "edits/remove":
        row, place = data.get("row"), data.get("place")
        if not isinstance(row, dict) or not isinstance(place, int):
            raise InputError("an edit to remove must be given with its place")
        session.remove(place, _edit(row))
    elif path == "threshold":
        value = data.get("threshold")
        if not isinstance(value, int | float) or not 0 < value < 1:
            raise InputError("the threshold must be a fraction between 0 and 1")
        session.choose_threshold(float(value))
    elif path == "measure":
        if not session.measure():
            raise RefusedError(409, "something is being measured already")
    else:
        raise RefusedError(404, "there is no such thing")
    return Answer.of(session.record())


def _edit(row: dict[str, Any]) -> dict[str, Any]:
    """A row of edits.csv from the page, checked for types."""
    edit: dict[str, Any] = {}
    for name, (dtype, _) in EDITS.columns.items():
        value = row.get(name)
        if dtype == "float64":
            if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
                raise InputError(f"{name} must be a number, got {value!r}")
            edit[name] = math.nan if value is None else float(value)
        else:
            edit[name] = value or ""
            if not isinstance(edit[name], str) or "\0" in edit[name]:
                raise InputError(f"{name} must be text")
    return edit
