"""One frame's part of a run: in memory, or in a store from which it is read when something is asked of it."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, overload

import numpy as np
import pandas as pd

from contactimg.files import FrameStore, KeyList, decode_part
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.parallel import FailedFrame
from contactimg.tables import CONTACTS, OUTLINES, REJECTED, SHARED_SHIFTS
from contactimg.tradeoff.choice import Choice

logger = logging.getLogger(__name__)

_NO_CHANGES: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """One frame's part of a run, in pixels.

    Parameters
    ----------
    contacts, rejected : DataFrame
    row : dict
        Its row of the frames table.
    shape : (int, int) or None
        Rows and columns; None for a frame that failed.
    own_optics : SharedOptics or None
        Contrast (grey levels) and blur that the frame alone shows; None where it shows nothing.
    level : float
        Grey level of its background; 0 where that was subtracted before.
    choice : Choice or None
        How it was measured and why, where that was chosen for a tolerance.
    outlines : DataFrame
        Of its contacts of free shape.
    film : FilmVerdict or None
        What its rims say of an air film; None where none was looked for.
    """

    contacts: pd.DataFrame
    rejected: pd.DataFrame
    row: dict[str, Any]
    shape: tuple[int, int] | None
    own_optics: SharedOptics | None = None
    level: float = 0.0
    choice: Choice | None = None
    outlines: pd.DataFrame = field(default_factory=OUTLINES.empty)
    film: FilmVerdict | None = None

    @classmethod
    def failed(cls, failure: FailedFrame) -> "MeasuredFrame":
        """The part of a frame that could not be measured: empty tables and a row that says why."""
        return cls(CONTACTS.empty(), REJECTED.empty(), failure.row, shape=None)

    @property
    def relative_optics(self) -> SharedOptics | None:
        """Its own optics with the contrast divided by the background, so that drifts of the lamp cancel."""
        return None if self.own_optics is None else self.own_optics.scaled(1.0 / (self.level or 1.0))

    @property
    def cubes(self) -> "SumOfCubes":
        """Uncertainties of the sum of the cubes of its radii."""
        return SumOfCubes.of(self.contacts)

    def with_choice(self, choice: Choice | None) -> "MeasuredFrame":
        """The same with the choice of the method, which is added to the message."""
        if choice is None:
            return self
        message = "; ".join(text for text in (self.row["message"], str(choice)) if text)
        return self._with(self.row | {"message": message}, choice)

    def _with(self, row: dict[str, Any], choice: Choice | None) -> "MeasuredFrame":
        """The same with another row and choice."""
        return replace(self, row=row, choice=choice)

    def whole(self) -> "MeasuredFrame":
        """The part with its tables in memory."""
        return self

    def records(self) -> tuple["FrameHead", "FrameTables"]:
        """What a store keeps of it, in two parts: most of what is done with a series needs the first only."""
        head = FrameHead(**{name: getattr(self, name) for name in (*_HEAD, "cubes")})
        return head, FrameTables(self.contacts, self.rejected, self.outlines)

    def log(self, before: str = "") -> None:
        """Log one line about the frame."""
        if logger.isEnabledFor(logging.INFO):
            logger.info("%s%s", before, self.summary())

    def summary(self) -> str:
        """One line about the frame."""
        numbers = (f"{key} {value:.4g}" for key, value in self.row.items() if isinstance(value, float))
        count = self.row.get("n_contacts", pd.NA)
        head = f"{self.row['frame']}: {self.row['status']}, {0 if pd.isna(count) else count} contacts, "
        return head + ", ".join(numbers)


@dataclass(frozen=True, eq=False)
class FrameTables:
    """The tables of a measured frame, in a store; see `MeasuredFrame`."""

    contacts: pd.DataFrame
    rejected: pd.DataFrame
    outlines: pd.DataFrame


@dataclass(frozen=True, eq=False)
class FrameHead:
    """A measured frame without its tables, in a store; see `MeasuredFrame`."""

    row: dict[str, Any]
    shape: tuple[int, int] | None
    own_optics: SharedOptics | None
    level: float
    choice: Choice | None
    film: FilmVerdict | None
    cubes: "SumOfCubes"

    def shelved(self, store: FrameStore, key: bytes) -> "ShelvedFrame":
        """The frame that stays in the store."""
        return ShelvedFrame(store, key)


_HEAD = tuple(item.name for item in fields(FrameHead) if item.name != "cubes")


@dataclass(frozen=True)
class SumOfCubes:
    """Standard uncertainties of the sum of a^3 over the contacts of a frame, by their source.

    Parameters
    ----------
    contacts : int
        Number of contacts.
    own : float, px^3
        From the independent errors of the radii.
    contrast, blur : float, px^3
        From what the contacts share: the contrast with the correlated blur, and the rest of the blur.
    edge : float, px^3
        From what the frame does not decide about its edges.
    """

    contacts: int
    own: float
    contrast: float
    blur: float
    edge: float

    @classmethod
    def of(cls, contacts: pd.DataFrame) -> "SumOfCubes":
        """Those of a contacts table."""
        slope = 3.0 * contacts["radius_px"].to_numpy(float) ** 2
        shifts = contacts[list(SHARED_SHIFTS)].to_numpy(float)
        alone = np.maximum(contacts["radius_std_px"].to_numpy(float) ** 2 - np.sum(shifts**2, axis=1), 0.0)
        return cls(len(contacts), float(np.sqrt(slope**2 @ alone)), *map(float, slope @ shifts))


class _InHead:
    """A field of a measured frame that is read from the store, unless it was changed since."""

    def __set_name__(self, _owner: type, name: str) -> None:
        self.name = name

    def __get__(self, part: "ShelvedFrame", _owner: type) -> Any:
        return part.changes[self.name] if self.name in part.changes else getattr(part.head(), self.name)


class _InTables:
    """A table of a measured frame that is read from the store."""

    def __set_name__(self, _owner: type, name: str) -> None:
        self.name = name

    def __get__(self, part: "ShelvedFrame", _owner: type) -> Any:
        return getattr(part.tables(), self.name)


class ShelvedFrame(MeasuredFrame):
    """A measured frame that stays in a store and is read each time something of it is asked for."""

    __slots__ = ("changes", "key", "store")

    store: FrameStore
    key: bytes
    changes: Mapping[str, Any]
    row: Any = _InHead()
    shape: Any = _InHead()
    own_optics: Any = _InHead()
    level: Any = _InHead()
    choice: Any = _InHead()
    film: Any = _InHead()
    cubes: Any = _InHead()
    contacts: Any = _InTables()
    rejected: Any = _InTables()
    outlines: Any = _InTables()

    def __init__(
        self, store: FrameStore, key: bytes, changes: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        for name, value in (("store", store), ("key", key), ("changes", changes)):
            object.__setattr__(self, name, value)

    def head(self) -> FrameHead:
        """What is not in tables."""
        head: FrameHead = self.store.get(self.key)
        return head

    def tables(self) -> FrameTables:
        """The tables."""
        tables: FrameTables = self.store.get(self.key, 1)
        return tables

    def __reduce__(self) -> tuple[Any, ...]:
        texts = (self.store.text(self.key, part) for part in (0, 1))
        return _whole_frame, (*texts, dict(self.changes))

    def _with(self, row: dict[str, Any], choice: Choice | None) -> MeasuredFrame:
        return ShelvedFrame(self.store, self.key, {"row": row, "choice": choice})

    def whole(self) -> MeasuredFrame:
        """The part with its tables in memory."""
        head = {name: getattr(self, name) for name in _HEAD}
        return MeasuredFrame(**head, **vars(self.tables()))


class MeasuredFrames(Sequence[MeasuredFrame]):
    """Measured frames in order; of those that are in a store only the key is in memory.

    Parameters
    ----------
    parts : iterable of MeasuredFrame
    """

    def __init__(self, parts: Iterable[MeasuredFrame] = ()) -> None:
        self._store: FrameStore | None = None
        self._keys = KeyList()
        self._others: dict[int, MeasuredFrame] = {}
        for part in parts:
            self.append(part)

    def __len__(self) -> int:
        return len(self._keys)

    @overload
    def __getitem__(self, index: int) -> MeasuredFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[MeasuredFrame]: ...

    def __getitem__(self, index: int | slice) -> MeasuredFrame | list[MeasuredFrame]:
        """One frame, or some."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = range(len(self))[index]
        key = self._keys[k]
        return self._others[k] if key is None or self._store is None else ShelvedFrame(self._store, key)

    def __setitem__(self, k: int, part: MeasuredFrame) -> None:
        if isinstance(part, ShelvedFrame) and not part.changes and self._store in (None, part.store):
            self._store, self._keys[k] = part.store, part.key
            self._others.pop(k, None)
        else:
            self._keys[k], self._others[k] = None, part

    def append(self, part: MeasuredFrame) -> None:
        """Add a frame at the end."""
        self._keys.append(None)
        self[len(self) - 1] = part


def _whole_frame(head: bytes, tables: bytes, changes: Mapping[str, Any]) -> MeasuredFrame:
    """A frame in memory, in the process that was handed what a store has of it."""
    stored = vars(decode_part(head)) | changes
    return MeasuredFrame(**{name: stored[name] for name in _HEAD}, **vars(decode_part(tables)))
