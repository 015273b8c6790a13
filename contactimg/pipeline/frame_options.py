"""How every command prepares a frame that it measures, and what it says of one that cannot be measured."""

import logging
from typing import Any

import numpy as np

from contactimg.errors import FrameError
from contactimg.frame import Frame
from contactimg.imaging.measure import CORRECTIONS
from contactimg.scene import Scene
from contactimg.tables import FAILED

logger = logging.getLogger(__name__)


def frame_options(frame: Frame, scene: Scene) -> dict[str, Any]:
    """Keywords of `contactimg.imaging.measure.measure_image` that prepare a frame as its scene says.

    Parameters
    ----------
    frame : Frame
    scene : Scene

    Returns
    -------
    dict
        ``polarity``; ``full_scale``, grey levels, infinite with ``[effects] saturation = "off"``; ``absent``,
        the corrections that are switched off. A number calibrated on frames is right for those only that
        were prepared in the same way.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> scene = scene_from_dict({"effects": {"saturation": "off", "dust": "off"}})
    >>> options = frame_options(Frame(np.zeros((3, 4), np.uint8)), scene)
    >>> options["full_scale"], options["absent"]
    (inf, frozenset({'dust'}))
    """
    return {
        "polarity": scene.images.polarity,
        "full_scale": np.inf if scene.effects.saturation == "off" else frame.full_scale,
        "absent": scene.effects.switched_off(*CORRECTIONS),
    }


def failed_row(name: str, error: Exception) -> dict[str, Any]:
    """The row of a frame that could not be measured, with the reason."""
    reason = str(error)
    if not isinstance(error, FrameError):
        logger.debug("%s", name, exc_info=error)
        reason = f"cannot be measured ({type(error).__name__}: {error})"
    return {"frame": name, "status": FAILED, "message": reason if name in reason else f"{name}: {reason}"}
