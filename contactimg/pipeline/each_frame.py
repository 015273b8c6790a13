"""The one loop over the frames of an experiment."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from threadpoolctl import threadpool_limits

from contactimg.engine.parallel import in_parallel
from contactimg.engine.processes import end_if_asked
from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameSource, PartStore, edits_file
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

    is_failure: ClassVar[bool] = True
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
    store: PartStore | None = None,
    shown: str = "",
) -> Iterator[Result | FailedFrame]:
    """Read the frames of an experiment and measure each; a frame that fails does not stop the others.

    Parameters
    ----------
    experiment : Experiment
    measure : callable
        Called with frame, pixels of the reference (None without one) and the rest of the job.
    jobs : sequence of tuple, optional
        Each a `contactimg.files.FrameSource` and further arguments; default: every frame of the experiment.
    store : PartStore, optional
        Results that it holds are taken from it, the others are added; failures are not.
    shown : str
        As for `contactimg.engine.progress.counted`.

    Yields
    ------
    result of ``measure``, or FailedFrame
        In order, a few frames in memory at a time.
    """
    jobs = [(frame,) for frame in experiment.frames] if jobs is None else jobs
    if not jobs:
        return
    reference = read_reference(experiment)

    def measured(source: FrameSource, *arguments: Any) -> Result | FailedFrame:
        try:
            with threadpool_limits(limits=1, user_api="blas"):  # threads make small products slower
                return measure(source.read(), reference, *arguments)
        except Exception as error:  # whatever it is, the other frames are not concerned
            return FailedFrame.of(source.name, error)

    if store is None:
        results = in_parallel(measured, iter(jobs), count=len(jobs), lost=_lost_frame, shown=shown)
    else:
        call = measure if isinstance(measure, partial) else partial(measure)
        references = [_without_folder(source) for source in experiment.references]
        settings = [f"{call.func.__module__}:{call.func.__qualname__}", call.args, call.keywords, references]
        # of the edits only those that concern a frame are part of its name: in its job and its corrections
        edits = edits_file(experiment.scene)
        common = store.common(settings, [path for path in experiment.others if path != edits])
        names = [store.name(common, source.path, [_without_folder(source), *rest]) for source, *rest in jobs]
        results = store.results(measured, jobs, names, lost=_lost_frame, shown=shown)
    for result in results:
        end_if_asked()
        yield result


def measured_and_failed(
    results: Iterable[Result | FailedFrame], nothing: str
) -> tuple[list[Result], list[dict[str, Any]]]:
    """The results of `for_each_frame`, and the rows of the frames that failed.

    Raises
    ------
    InputError
        If there is no result: ``nothing``, and the first reason.
    """
    every = list(results)
    failed = [one.row for one in every if isinstance(one, FailedFrame)]
    if len(failed) == len(every):
        raise InputError(f"{nothing}; the first: {failed[0]['message']}")
    return [one for one in every if not isinstance(one, FailedFrame)], failed


def _lost_frame(error: Exception, source: FrameSource, *_arguments: Any) -> FailedFrame:
    """The failure of a frame whose workers were ended."""
    return FailedFrame.of(source.name, FrameError(f"its measurement {error}"))


def _without_folder(source: FrameSource) -> FrameSource:
    """The source with the name of its file only."""
    return replace(source, path=Path(source.path.name))
