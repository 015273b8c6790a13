"""The one loop over the frames of an experiment."""

import logging
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, overload

from numpy.typing import NDArray

from contactimg.engine.calls import in_parallel
from contactimg.errors import FrameError
from contactimg.files import (
    EncodedResult,
    Experiment,
    FrameSource,
    FrameStore,
    KeyList,
    decode_part,
    edits_file,
)
from contactimg.pipeline.inputs import read_reference
from contactimg.tables import Status

logger = logging.getLogger(__name__)

Result = TypeVar("Result")


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
        As for `contactimg.engine.calls.in_parallel`.
    advance : callable, optional
        Called once a frame, in order.
    store : FrameStore, optional
        Results that are in it are taken from it, the others are added; failures are not. Results that can
        (``shelved``) stay in it.

    Yields
    ------
    result of ``measure``, or FailedFrame
        In order, a few frames in memory at a time.
    """
    whole, jobs = jobs is None, Jobs(experiment.frames) if jobs is None else jobs
    keys: Sequence[bytes | None] = [None] * len(jobs)
    if store is not None:
        keys = _store_keys(store, experiment, measure, jobs)

    def compute(numbers: Sequence[int]) -> Iterator[Result | FailedFrame]:
        chosen = (jobs[k] for k in numbers)
        call = measure if None in keys else partial(_encoded, measure)
        return _measure_jobs(experiment, call, chosen, count=len(numbers), workers=workers)

    for part in through_store(store, keys, compute, what="frames" if whole else "", work="measured"):
        yield part
        if advance is not None:
            advance()


class Jobs(Sequence[tuple[Any, ...]]):
    """Frames to measure, each with the arguments that are made when it is its turn.

    Parameters
    ----------
    frames : sequence of FrameSource
    numbers : sequence of int, optional
        Which of them; default: all.
    arguments : callable, optional
        Gives what a frame's measurement needs besides its pixels, from the frame's number.
    """

    def __init__(
        self,
        frames: Sequence[FrameSource],
        numbers: Sequence[int] | None = None,
        arguments: Callable[[int], tuple[Any, ...]] = lambda _: (),
    ) -> None:
        self._frames = frames
        self._numbers = range(len(frames)) if numbers is None else numbers
        self._arguments = arguments

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> tuple[Any, ...]: ...

    @overload
    def __getitem__(self, index: slice) -> "Jobs": ...

    def __getitem__(self, index: int | slice) -> "tuple[Any, ...] | Jobs":
        """One job, or some."""
        if isinstance(index, slice):
            return Jobs(self._frames, self._numbers[index], self._arguments)
        number = self._numbers[index]
        return self._frames[number], *self._arguments(number)


def through_store(
    store: FrameStore | None,
    keys: Sequence[bytes | None],
    compute: Callable[[Sequence[int]], Iterator[Result]],
    *,
    what: str,
    work: str,
) -> Iterator[Result]:
    """Results in order: from a store where it has them; the others are computed and added to it.

    Parameters
    ----------
    store : FrameStore or None
    keys : sequence of bytes or None
        One a result; None where it is not stored.
    compute : callable
        Gives the results of the numbers that the store lacks, in order; as they are, or encoded.
    what, work : str
        For the message that says how much was done: what is counted, and what is done with the others. No
        message without ``what``.
    """
    done = bytearray(store is not None and key in store for key in keys)
    if what and any(done) and store is not None and store.resumes:
        logger.warning(
            "%s of %s %s were done by a run that was ended; the others are %s",
            f"{sum(done):,}",
            f"{len(keys):,}",
            what,
            work,
        )
    new = compute(array("q", (k for k, known in enumerate(done) if not known)))
    for key, known in zip(keys, done, strict=True):
        if store is None or key is None:
            yield next(new)
        else:
            yield _on_shelf(store.get(key), store, key) if known else _stored(next(new), store, key)


def _encoded(measure: Callable[..., Any], *arguments: Any) -> Any:
    """In a worker: a measurement as a store keeps it, if it has a text."""
    result = measure(*arguments)
    return EncodedResult.of(result) or result


def _stored(part: Any, store: FrameStore, key: bytes) -> Any:
    """A new result in the store; a failure, and one that has no text, stays as it is."""
    if isinstance(part, FailedFrame):
        return part
    encoded = part if isinstance(part, EncodedResult) else EncodedResult.of(part)
    if encoded is None:
        return part
    store.put(key, encoded)
    return _on_shelf(decode_part(encoded.texts[0]), store, key)


def _on_shelf(first: Any, store: FrameStore, key: bytes) -> Any:
    """A result by its first record: it stays in the store if it can be read from there again."""
    shelve = getattr(first, "shelved", None)
    return first if shelve is None else shelve(store, key)


def _measure_jobs(
    experiment: Experiment,
    measure: Callable[..., Result],
    jobs: Iterable[tuple[Any, ...]],
    *,
    count: int,
    workers: int | None,
) -> Iterator[Result | FailedFrame]:
    """Measure jobs in several processes."""
    if not count:
        return iter(())
    reference = read_reference(experiment)
    call = partial(_measure_source, measure, None if reference is None else reference.image)
    return in_parallel(call, jobs, count=count, workers=workers, lost=_lost_frame)


def _lost_frame(error: Exception, source: FrameSource, *_arguments: Any) -> FailedFrame:
    """The failure of a frame whose workers were ended."""
    return FailedFrame.of(source.name, FrameError(f"its measurement {error}"))


def _store_keys(
    store: FrameStore, experiment: Experiment, measure: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]
) -> KeyList:
    """The key of each job in the store."""
    call = measure if isinstance(measure, partial) else partial(measure)
    function = f"{call.func.__module__}:{call.func.__qualname__}"
    references = [_without_folder(source) for source in experiment.references]
    # of the edits only those that concern a frame are part of its key: of its settings and its corrections
    edits = edits_file(experiment.scene, experiment.scene.folder)
    common = store.common(
        [function, call.args, references], [path for path in experiment.others if path != edits]
    )
    return KeyList(
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
    )


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
