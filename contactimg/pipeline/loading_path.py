"""The loads that came before a load, on the loading path that the scene states."""

from collections.abc import Sequence

from contactimg.models.load_spring import LoadSpring
from contactimg.prediction import Prescribed
from contactimg.scene import Scene


def loads_before(scene: Scene, load: Prescribed, loads: Sequence[Prescribed]) -> tuple[Prescribed, ...]:
    """The loads on the way to one of several loads.

    Parameters
    ----------
    scene : Scene
        ``[load] path``: first loading, unloading from the largest of the loads, or the loads before.
    load : float, N, or LoadSpring
    loads : sequence of float, N, or of LoadSpring
        All loads of the command.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> loads_before(scene_from_dict({"load": {"path": "unloading"}}), 0.1, [0.1, 0.5, 0.01, 0.2])
    (0.5, 0.2)
    """
    path = scene.load.path
    if path == "loading":
        return ()
    if path != "unloading":
        return tuple(path)
    higher = [other for other in loads if type(other) is type(load) and _level(other) > _level(load)]
    return tuple(sorted(higher, key=_level, reverse=True))


def _level(load: Prescribed) -> float:
    """What orders loads, or displacements of the stage."""
    return load.displacement if isinstance(load, LoadSpring) else float(load)
