"""What the page may ask for: fixed names only, so that no path of a request ever reaches the disk."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from contactimg.errors import InputError
from contactimg.review.frame_view import LIGHT_TOP
from contactimg.review.session import Session
from contactimg.review.shown_tables import TABLES
from contactimg.tables import EDITS, Flag
from contactimg.tables.contact_kinds import kind_of_rejected, kinds_of_contacts

PAGE_FILES = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
}
"""Last part of the address -> file of this package and its type."""


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


def answer_get(session: Session, path: str) -> Answer | None:
    """The answer to a request that changes nothing; None if there is no such thing.

    Parameters
    ----------
    session : Session
    path : str
        Part of the address after the token.
    """
    if path in PAGE_FILES:
        name, kind = PAGE_FILES[path]
        return Answer(files("contactimg.review").joinpath(name).read_bytes(), kind)
    if path == "job.json":
        return Answer.of(vars(session.jobs.state))
    if path == "run.json":
        fixed = {
            "kinds": [kind.record for kind in kinds_of_contacts()],
            "rejected": kind_of_rejected().record,
            "flags": {str(flag.name): int(flag) for flag in Flag},
            "light_top": LIGHT_TOP,
        }
        return Answer.of(session.record() | fixed)
    if path.startswith("tables/") and path.removeprefix("tables/") in TABLES:
        return Answer(session.tables().text(path.removeprefix("tables/")), "text/csv; charset=utf-8")
    match = re.fullmatch(r"frames/(\d{1,7})/([a-z]+)(?:/(\d{1,9}))?\.(?:json|png)", path)
    if match is None or int(match[1]) >= len(session.sources):
        return None
    number, what, label = int(match[1]), match[2], match[3]
    if label is not None:
        return Answer.of(session.window(number, int(label))) if what == "contact" else None
    pictures: dict[str, Callable[[int], bytes]] = {
        "image": session.picture,
        "light": session.light_picture,
    }
    if what in pictures:
        return Answer(pictures[what](number), "image/png")
    data = {"contacts": session.contacts, "preview": session.preview, "curves": session.curves}
    return Answer.of(data[what](number)) if what in data else None


def answer_post(session: Session, path: str, data: dict[str, Any]) -> Answer | None:
    """The answer to a request that changes something; what it changes is on the disk by then.

    Raises
    ------
    InputError
        If the request is not valid.
    """
    if path == "edits/insert":
        rows, place = data.get("rows"), data.get("place")
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise InputError("rows must be a list of edits")
        session.insert([_in_one_line(_edit(row)) for row in rows], place if isinstance(place, int) else None)
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
    elif path in ("measure", "plateau"):
        first = data.get("first")
        known = isinstance(first, int) and 0 <= first < len(session.sources)
        started = session.measure(first if known else None) if path == "measure" else session.find_plateau()
        if not started:
            return Answer.of({"error": "something is being measured already"}, 409)
    elif path == "cancel":
        session.jobs.cancel()
    else:
        return None
    return Answer.of(session.record())


LONGEST_TEXT = 100_000
"""Characters of a text in an edit. Chosen: a mask of 10,000 corners."""


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
            if not isinstance(edit[name], str) or len(edit[name]) > LONGEST_TEXT or "\0" in edit[name]:
                raise InputError(f"{name} must be text")
    return edit


def _in_one_line(edit: dict[str, Any]) -> dict[str, Any]:
    """An edit without line breaks in what a person writes."""
    return edit | {name: " ".join(edit[name].split()) for name in ("author", "reason")}
