"""Inputs of a computation from a scene: its reference, its asperities, its loads and their order."""

import logging
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files import Experiment, read_scene_asperities, read_scene_loads
from contactimg.files.atomic import naming
from contactimg.imaging.pooled import average_references
from contactimg.scene import Scene
from contactimg.surfaces import composite_apexes, generate_asperities

logger = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def read_reference(experiment: Experiment) -> NDArray | None:
    """The pixels of the reference of an experiment; several are registered and averaged.

    Returns
    -------
    ndarray, shape (rows, columns), or None
        None if the scene names no reference. One reference is returned as it was read; the mean of several
        has single precision and lies where the first of them does.

    Raises
    ------
    FrameError
        If one cannot be read.
    InputError
        If they differ in size.
    """
    frames = [source.read() for source in experiment.references]
    if len(frames) < 2:
        return frames[0].image if frames else None
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        sizes = ", ".join(sorted(f"{columns} x {rows}" for rows, columns in shapes))
        raise InputError(f"the references differ in size ({sizes} pixels); they must show the same field")
    mean, left_out = average_references([frame.image for frame in frames])
    for number in left_out:
        name = experiment.references[number].name
        logger.warning("%s: left out of the mean of the references; it differs from the others", name)
    return mean


def check_modulus(scene: Scene) -> None:
    """Refuse an elastic body without its modulus, which the local forces need, before frames are measured."""
    if scene.elastic is not None:
        with naming(scene.folder):
            _ = scene.elastic.young_modulus


def scene_asperities(scene: Scene) -> pd.DataFrame | None:
    """The scene's asperity table, read from its file or generated from its seed; None if it has neither."""
    section = scene.asperities
    if section is None or section.generate is None:
        return read_scene_asperities(scene)
    rng = np.random.default_rng(section.seed)
    return generate_asperities(section.generate, side=section.side, coverage=section.coverage, rng=rng)


def need_asperities(scene: Scene, purpose: str) -> pd.DataFrame:
    """The scene's asperity table, or an `InputError` that says what it is needed for."""
    asperities = scene_asperities(scene)
    if asperities is None:
        raise InputError(f"{purpose} needs asperities; give [asperities] a file, or generate them")
    return asperities


def asperities_and_sites(experiment: Experiment) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
    """The asperities of an experiment, and their composite summits.

    Without a camera no contact has a place, and the asperities are left out.
    """
    scene = experiment.scene
    if scene.camera is None:
        return None, None
    asperities = scene_asperities(scene) if experiment.asperities is None else experiment.asperities
    return asperities, None if asperities is None else contact_sites(asperities, scene)


def contact_sites(asperities: pd.DataFrame, scene: Scene) -> pd.DataFrame:
    """The places and radii of first touch: the composite summits of the asperities under the indenter."""
    if scene.indenter is None:
        return asperities
    return composite_apexes(asperities, indenter_radius=scene.indenter.radius, apex=scene.indenter.apex)


def largest_load(scene: Scene) -> float:
    """The largest load that the scene states (N).

    Raises
    ------
    InputError
        If it states none.
    """
    stated = scene.simulate.loads if scene.simulate is not None else []
    loads = stated or read_scene_loads(scene)
    if not loads:
        raise InputError("the scene states no load; give one, [simulate] loads_N, [images] loads or --load-N")
    return max(loads)
