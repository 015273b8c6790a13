"""How much work a frame may cost: counted in pixels and iterations, so that results do not depend on time.

Images without disks (photographs, text, dirty plates) have groups that no cover explains, and each of them
would be tried for long. What is left when the work is done stays as it is, and the frame says how much.
"""

from dataclasses import dataclass

from contactimg.imaging.fit.settings import (
    COVER_SHARE,
    FIRST_STEP_RATIO,
    PASSES_AFTER_COVERS,
    WORK_PER_FIT,
    WORK_PER_PIXEL,
    WORK_PER_SMALL_FRAME,
)
from contactimg.imaging.kernels.gauss_newton import WORK_PER_DISK


class TooMuchWork(Exception):  # noqa: N818
    """A fit was not begun: one step of it would have taken more than is left for its frame."""


@dataclass
class Work:
    """Work done for a frame, counted on by every fit of it.

    Parameters
    ----------
    limit : float
        Pixels times iterations; infinite outside a frame.
    done : float
        So far, without what deep overlaps took besides.
    deep : float
        That, of fits of the whole frame.
    unresolved_groups : int
        Groups that fit badly and were left as they are.
    unfinished_fits : int
        Fits that were cut off before they had settled.
    refused : bool
        Whether the disks that were detected were not fitted, because one step would have taken too much.
    given_up : bool
        Whether nothing further shall be tried, whatever is left.
    longest_pass : float
        Work of one iteration over all disks of the frame.
    """

    limit: float = float("inf")
    done: float = 0.0
    deep: float = 0.0
    unresolved_groups: int = 0
    unfinished_fits: int = 0
    refused: bool = False
    given_up: bool = False
    longest_pass: float = 0.0

    @classmethod
    def of_frame(cls, pixels: int) -> "Work":
        """What a frame of so many pixels may cost."""
        return cls(WORK_PER_SMALL_FRAME + WORK_PER_PIXEL * pixels)

    def count_fit(self, work: float, deep: float = 0.0, *, cut_off: bool, iterations: int = 1) -> None:
        """Add a fit that took so much besides its overhead, and may have been cut off."""
        self.longest_pass = max(self.longest_pass, work / max(iterations, 1))
        self.done += WORK_PER_FIT + work
        self.deep += deep
        self.unfinished_fits += cut_off

    def give_up(self) -> None:
        """Try nothing further: nothing that would help is left."""
        self.given_up = True

    @property
    def ran_out(self) -> bool:
        """Whether the frame would have taken more than it may."""
        return self.is_done or self.unfinished_fits > 0 or self.refused

    @property
    def left(self) -> float:
        """What may still be done."""
        return 0.0 if self.given_up else max(self.limit - self.done, 0.0)

    @property
    def left_for_first_step(self) -> float:
        """What the first step of a fit may take: a fit that follows one that was cut off needs one."""
        return max(FIRST_STEP_RATIO * self.limit - self.done - self.deep, 0.0)

    def most_disks(self, iterations: int, *, pixels: float) -> int:
        """How many disks of so many pixels each may still be fitted."""
        left = 0.0 if self.no_more_covers else COVER_SHARE * self.limit - self.done
        return int(min(left / (iterations * (pixels + WORK_PER_DISK)), 1e9))

    @property
    def is_done(self) -> bool:
        """Whether nothing further shall be tried."""
        return self.given_up or self.done > self.limit

    @property
    def no_more_covers(self) -> bool:
        """Whether no further covers of groups shall be tried."""
        return self.done > COVER_SHARE * self.limit or not self.suffices_for(PASSES_AFTER_COVERS)

    def suffices_for(self, passes: int) -> bool:
        """Whether so many iterations over all disks are left."""
        return not self.given_up and self.done + passes * self.longest_pass <= self.limit
