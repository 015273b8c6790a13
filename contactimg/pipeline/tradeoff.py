"""Accuracy against computing time for a scene: read its files, measure its knobs."""

from collections.abc import Sequence
from contextlib import suppress
from math import inf, nan

import numpy as np

from contactimg.errors import InputError, finite_number
from contactimg.files import open_experiment
from contactimg.pipeline.inputs import largest_load, read_reference, scene_asperities
from contactimg.scene import Scene
from contactimg.tradeoff.knobs import Case, OwnFrame, applicable_knobs
from contactimg.tradeoff.measure import Knob, Tradeoff, run_knobs


def measure_tradeoff(scene: Scene, *, load: float | None = None, knobs: str | Sequence[str] = ()) -> Tradeoff:
    """Measure computing time against accuracy: the settings of each knob, compared in one run.

    Parameters
    ----------
    scene : Scene
        ``[tolerance] output`` says what the errors are of, ``relative`` what the sentences are for.
    load : float, optional, N
        By default the largest of the scene.
    knobs : str or sequence of str
        Of ``image`` (measurement of a frame), ``model`` (contact model); those that apply if
        none is named.

    Returns
    -------
    Tradeoff
        Errors are relative to a converged answer, which each row names. A setting that fails has a row that
        says why.

    Raises
    ------
    InputError
        If no knob applies to the scene, with the reasons, or no setting can be run.

    Notes
    -----
    Times are the best of up to seven runs taken in turn in this process; compare them with each other, not
    with those of another run.

    Examples
    --------
    >>> from contactimg import scene_from_dict
    >>> scene = scene_from_dict({
    ...     "indenter": {"radius_m": 0.1288, "apex_m": [0.001, 0.001]}, "elastic": {"young_modulus_Pa": 3e6},
    ...     "asperities": {"generate": "SA", "side_m": 0.002},
    ... })
    >>> found = measure_tradeoff(scene, load=0.01, knobs=["model"])
    >>> sorted(found.sentences)
    ['model']
    """
    chosen, left_out = prepare_tradeoff(scene, load=load, knobs=[knobs] if isinstance(knobs, str) else knobs)
    # 15 s for repeated runs of the settings: chosen by hand
    return run_knobs(chosen, relative=scene.tolerance.relative, seconds=15.0, left_out=left_out)


def prepare_tradeoff(
    scene: Scene, *, load: float | None = None, knobs: Sequence[str] = ()
) -> tuple[list[Knob], dict[str, str]]:
    """The knobs of a scene with their settings, not yet run, and why others do not apply.

    Parameters
    ----------
    scene, load, knobs
        As for `measure_tradeoff`.
    """
    if load is None:
        load = nan
        with suppress(InputError):
            load = largest_load(scene)
    else:
        load = finite_number(load, "load", "N")
    asperities = scene_asperities(scene)
    renderable = None not in (scene.simulate, scene.camera, scene.elastic) and asperities is not None
    measured = None if renderable else _own_frame(scene, load)
    return applicable_knobs(Case(scene, asperities, load, measured=measured), knobs)


def _own_frame(scene: Scene, load: float) -> OwnFrame | None:
    """A measured frame of the scene: at the given load, or the last one; None without files of frames."""
    try:
        experiment = open_experiment(scene, pulled=True)
    except InputError:
        return None
    loads = experiment.loads["load_N"].to_numpy(float)
    known = np.isfinite(loads) & np.isfinite(load)
    row = int(np.argmin(np.where(known, np.abs(loads - load), inf))) if known.any() else len(loads) - 1
    return OwnFrame(experiment.frames[row].read(), read_reference(experiment), float(loads[row]))
