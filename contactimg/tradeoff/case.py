"""The case that a trade-off is measured for: a scene at a load, its asperities and frames."""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.frame import Frame
from contactimg.scene import Scene

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BoundarySolution:
    """A stored boundary-element solution.

    Parameters
    ----------
    scene : Scene
        Indenter and elastic body.
    asperities : DataFrame
    load : float, N
    force, radius : ndarray, shape (n,), N and m
        Force and contact radius of each asperity.
    seconds : float
        Computing time on one core.
    """

    scene: Scene
    asperities: pd.DataFrame
    load: float
    force: Values
    radius: Values
    seconds: float


@dataclass(frozen=True, eq=False)
class OwnFrame:
    """A measured frame of the scene, whose true contacts are not known.

    Parameters
    ----------
    frame : Frame
    reference : Frame or None
    load : float, N
        NaN if not known.
    """

    frame: Frame
    reference: Frame | None
    load: float


@dataclass(frozen=True, eq=False)
class Case:
    """A scene at a load.

    Parameters
    ----------
    scene : Scene
    asperities : DataFrame or None
    load : float, N
        NaN without a load.
    truth : BoundarySolution or None
    measured : OwnFrame or None
    fine : bool
        Whether slow settings are measured as well.
    """

    scene: Scene
    asperities: pd.DataFrame | None = None
    load: float = math.nan
    truth: BoundarySolution | None = None
    measured: OwnFrame | None = None
    fine: bool = False

    @property
    def output(self) -> str:
        """The result that must be accurate."""
        return self.scene.tolerance.output
