"""Calls in several processes, and the one loop over the frames of an experiment."""

import logging
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from joblib import Parallel, delayed, effective_n_jobs
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import Experiment, FrameSource, FrameStore, edits_file
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.worker_life import live_with_parent
from contactimg.tables import Status
from contactimg.timings import collect_call, gather, is_collecting

logger = logging.getLogger(__name__)

Result = TypeVar("Result")

FEW_CALLS = 4
"""Below this number of calls starting processes costs more than it gains. Chosen by hand; sensitivity not
measured."""


def in_parallel(
    function: Callable[..., Result], arguments: Iterable[tuple[Any, ...]], *, count: int, workers: int | None
) -> Iterator[Result]:
    """Call a function for each tuple of arguments and yield the results in order, a few in memory at a time.

    Parameters
    ----------
    function : callable
        Must not depend on the order of the calls.
    arguments : iterable of tuple
        Taken as they are needed.
    count : int
        Number of calls.
    workers : int or None
        Processes; None for one per core, or only this one for fewer than `FEW_CALLS` calls.

    Notes
    -----
    The workers end with this process, whatever ends it (`contactimg.pipeline.worker_life`).
    """
    if workers is None:
        workers = 1 if count < FEW_CALLS else -1
    processes = effective_n_jobs(workers)
    if processes == 1:
        return (function(*item) for item in arguments)
    pool = Parallel(
        n_jobs=workers,
        backend="loky",
        return_as="generator",
        pre_dispatch="2*n_jobs",
        initializer=live_with_parent,
        initargs=(os.getpid(),),
    )
    if not is_collecting():
        return _closing(pool(delayed(function)(*item) for item in arguments))
    timed = pool(delayed(collect_call)(function, *item) for item in arguments)
    return gather(_closing(timed), processes=processes)


def _closing(results: Generator[Result]) -> Iterator[Result]:
    """The results; if the caller is interrupted, the calls that still run are ended with their processes."""
    try:
        yield from results
    finally:
        results.close()


@dataclass(frozen=True)
class FailedFrame:
    """A frame that could not be read or measured.

    Parameters
    ----------
    row : dict
        Frame, status and message, for a table with these columns.
    """

    row: dict[str, Any]

    @classmethod
    def of(cls, name: str, error: Exception) -> "FailedFrame":
        """The failure of the frame of this name, with the reason."""
        reason = str(error)
        if not isinstance(error, FrameError):
            logger.debug("%s", name, exc_info=error)
            reason = f"cannot be measured ({type(error).__name__}: {error})"
        message = reason if name in reason else f"{name}: {reason}"
        return cls({"frame": name, "status": Status.FAILED, "message": message})


def for_each_frame(
    experiment: Experiment,
    measure: Callable[..., Result],
    jobs: Sequence[tuple[Any, ...]] | None = None,
    *,
    workers: int | None,
    advance: Callable[[], None] | None = None,
    store: FrameStore | None = None,
) -> Iterator[Result | FailedFrame]:
    """Read the frames of an experiment and measure each; a frame that fails does not stop the others.

    Parameters
    ----------
    experiment : Experiment
    measure : callable
        Called with frame, pixels of the reference (None without one) and the rest of the job.
    jobs : sequence of tuple, optional
        Each a `contactimg.files.FrameSource` and further arguments; default: every frame of the experiment.
    workers : int or None
        As for `in_parallel`.
    advance : callable, optional
        Called once a frame, in order.
    store : FrameStore, optional
        Results that are in it are taken from it, the others are added; failures are not. Results that can
        (``shelved``) leave their tables in it.

    Yields
    ------
    result of ``measure``, or FailedFrame
        In order, a few frames in memory at a time.
    """
    whole, jobs = jobs is None, [(source,) for source in experiment.frames] if jobs is None else jobs
    keys: Sequence[str | None] = [None] * len(jobs)
    if store is not None:
        keys = _store_keys(store, experiment, measure, jobs)
    done = [store is not None and key in store for key in keys]
    if whole and any(done) and store is not None and store.resumes:
        logger.warning(
            "%s of %s frames were done by a run that was ended; the others are measured",
            f"{sum(done):,}",
            f"{len(jobs):,}",
        )
    missing = [job for job, known in zip(jobs, done, strict=True) if not known]
    new = _measure_jobs(experiment, measure, missing, workers=workers)
    for key, known in zip(keys, done, strict=True):
        if known and store is not None and key is not None:
            part = store.get(key)
        else:
            part = next(new)
            if store is not None and key is not None and not isinstance(part, FailedFrame):
                store.put(key, part)
        yield part if store is None or key is None or key not in store else _shelved(part, store, key)
        if advance is not None:
            advance()


def _shelved(part: Any, store: FrameStore, key: str) -> Any:
    """A result without what can be read again from the store."""
    shelve = getattr(part, "shelved", None)
    return part if shelve is None else shelve(partial(store.get, key))


def _measure_jobs(
    experiment: Experiment,
    measure: Callable[..., Result],
    jobs: Sequence[tuple[Any, ...]],
    *,
    workers: int | None,
) -> Iterator[Result | FailedFrame]:
    """Measure jobs in several processes."""
    if not jobs:
        return iter(())
    reference = read_reference(experiment)
    call = partial(_measure_source, measure, None if reference is None else reference.image)
    return in_parallel(call, jobs, count=len(jobs), workers=workers)


def _store_keys(
    store: FrameStore, experiment: Experiment, measure: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]
) -> list[str | None]:
    """The key of each job in the store."""
    call = measure if isinstance(measure, partial) else partial(measure)
    function = f"{call.func.__module__}:{call.func.__qualname__}"
    references = [_without_folder(source) for source in experiment.references]
    frames = {source.path for source in experiment.frames}
    # of the edits only those that concern a frame are part of its key: of its settings and its corrections
    others = frames | {edits_file(experiment.scene, experiment.scene.folder)}
    common = store.common(
        [function, call.args, references], [path for path in experiment.inputs if path not in others]
    )
    return [
        store.key(
            common,
            job[0].path,
            [
                _without_folder(job[0]),
                *(_of_frame(value, job[0].name) for value in job[1:]),
                {name: _of_frame(value, job[0].name) for name, value in call.keywords.items()},
            ],
        )
        for job in jobs
    ]


def _of_frame(value: Any, name: str) -> Any:
    """The part of a setting that concerns one frame."""
    narrow = getattr(value, "of_frame", None)
    return value if narrow is None else narrow(name)


def _without_folder(source: FrameSource) -> FrameSource:
    """The source with the name of its file only, and the corrections that concern it."""
    return replace(source, path=Path(source.path.name), correct=_of_frame(source.correct, source.name))


def _measure_source(
    measure: Callable[..., Result], reference: NDArray | None, source: FrameSource, *arguments: Any
) -> Result | FailedFrame:
    """Read and measure one frame; whatever goes wrong becomes a failure of this frame alone."""
    try:
        return measure(source.read(), reference, *arguments)
    except Exception as error:  # whatever it is, the other frames are not concerned
        return FailedFrame.of(source.name, error)
