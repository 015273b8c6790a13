"""What a trade-off is measured on: a scene at a load, its asperities, its frames."""

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
    """A boundary-element solution that is stored.

    Parameters
    ----------
    scene : Scene
        Indenter and elastic body.
    asperities : DataFrame
    load : float, N
    force, radius : ndarray, shape (n,), N and m
        Of each asperity.
    seconds : float
        What it took on one core.
    """

    scene: Scene
    asperities: pd.DataFrame
    load: float
    force: Values
    radius: Values
    seconds: float


@dataclass(frozen=True, eq=False)
class OwnFrame:
    """A frame of the scene's own, without truth.

    Parameters
    ----------
    frame : Frame
    reference : Frame or None
    load : float, N
        NaN if it is not known.
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
        NaN if there is none.
    truth : BoundarySolution or None
    measured : OwnFrame or None
    fine : bool
        More settings, up to slow ones.
    """

    scene: Scene
    asperities: pd.DataFrame | None = None
    load: float = math.nan
    truth: BoundarySolution | None = None
    measured: OwnFrame | None = None
    fine: bool = False

    @property
    def output(self) -> str:
        """What must be accurate."""
        return self.scene.tolerance.output
