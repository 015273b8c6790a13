"""Computing time of a run by named stages; without a collector, a stage costs next to nothing.

Time is charged to the innermost stage that has been entered, so that all stages and the time outside them add
up to the elapsed time. Worker processes time their own stages, which are added to those of this process.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, TypeVar

OTHER = "other"
"""Time outside of all stages."""

WAITING = "waiting for processes"
"""Time in which this process waits for the results of others."""

Result = TypeVar("Result")


@dataclass
class Timings:
    """Time and number of calls of each stage.

    Attributes
    ----------
    seconds : dict
        Stage -> wall time without that of the stages inside, s.
    calls : Counter
        Stage -> times it was entered.
    entered : list of str
        The stages around the current one, and it.
    """

    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    calls: Counter[str] = field(default_factory=Counter)
    entered: list[str] = field(default_factory=lambda: [OTHER])
    _since: float = field(default_factory=perf_counter)

    def charge(self) -> None:
        """Charge the time since the last change of stage to the current stage."""
        now = perf_counter()
        self.seconds[self.entered[-1]] += now - self._since
        self._since = now

    def add(self, other: "Timings") -> None:
        """Add the stages that another process has timed."""
        for name, seconds in other.seconds.items():
            self.seconds[name] += seconds
        self.calls += other.calls

    def rows(self) -> list[tuple[str, int, float]]:
        """Stage, calls and seconds, the longest first and what is outside of all stages last."""
        self.charge()
        names = sorted(self.seconds, key=lambda name: (name == OTHER, -self.seconds[name]))
        return [(name, self.calls[name], self.seconds[name]) for name in names]


_collector: ContextVar[Timings | None] = ContextVar("contactimg_timings", default=None)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """A named part of the work, as a context or as a decorator.

    Parameters
    ----------
    name : str

    Examples
    --------
    >>> with collect() as timings:
    ...     with stage("reading"):
    ...         pass
    >>> timings.calls["reading"]
    1
    """
    timings = _collector.get()
    if timings is None:
        yield
        return
    timings.charge()
    timings.entered.append(name)
    timings.calls[name] += 1
    try:
        yield
    finally:
        timings.charge()
        timings.entered.pop()


@contextmanager
def collect() -> Iterator[Timings]:
    """Time the stages that are entered inside the block.

    Yields
    ------
    Timings
    """
    timings = Timings()
    token = _collector.set(timings)
    try:
        yield timings
    finally:
        timings.charge()
        _collector.reset(token)


def collect_call(function: Callable[..., Result], *arguments: Any) -> tuple[Result, Timings]:
    """Call a function and time its stages, for a worker process that returns both."""
    with collect() as timings:
        result = function(*arguments)
    return result, timings


def gather(results: Iterable[tuple[Result, Timings]]) -> Iterator[Result]:
    """The results of `collect_call` in other processes; their stages are added to the current timings.

    Parameters
    ----------
    results : iterable of (result, Timings)
        Taken as they are ready.

    Yields
    ------
    result
    """
    pending, timings = iter(results), _collector.get()
    while True:
        with stage(WAITING):
            item = next(pending, None)
        if item is None:
            return
        if timings is not None:
            timings.add(item[1])
        yield item[0]
