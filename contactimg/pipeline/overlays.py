"""A picture of each frame with its measured contacts."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from contactimg.files import Experiment, FrameSource, write_figure
from contactimg.pipeline.parallel import in_parallel
from contactimg.pipeline.pictures import draw_measured
from contactimg.pipeline.series import Run
from contactimg.pose import Pose
from contactimg.tables import CONTACTS, FAILED
from contactimg.timings import stage


def draw_overlays(
    run: Run,
    experiment: Experiment,
    folder: Path,
    *,
    workers: int | None,
    advance: Callable[[], None] | None = None,
) -> None:
    """Draw the measured contacts on every frame that could be measured, as PNG files."""
    folder.mkdir()
    failed = set(run.frames.loc[run.frames["status"] == FAILED, "frame"])
    pose = None if run.pose is None else run.pose.pose
    sources = [source for source in experiment.frames if source.name not in failed]
    groups = dict(list(run.contacts.groupby("frame")))
    jobs = ((source, groups.get(source.name, CONTACTS.empty()), pose, folder) for source in sources)
    for _ in in_parallel(_draw, jobs, count=len(sources), workers=workers):
        if advance is not None:
            advance()


def picture_name(frame: str) -> str:
    """File name of the picture of a frame."""
    return frame.replace("[", "_").replace("]", "") + ".png"


@stage("pictures")
def _draw(source: FrameSource, contacts: pd.DataFrame, pose: Pose | None, folder: Path) -> None:
    """Read one frame again and draw it."""
    ax = draw_measured(source.read().image, contacts, pose=pose, title=source.name)
    write_figure(ax, folder / picture_name(source.name))
