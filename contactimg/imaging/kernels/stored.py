"""Whether the compiled functions are stored on this computer."""

from pathlib import Path

from contactimg.imaging.kernels.gauss_newton import iterate


def kernels_are_stored() -> bool:
    """Whether numba stored compiled code of the fit; where it compiles nothing, there is nothing to store."""
    stats = getattr(iterate, "stats", None)
    return stats is None or any(Path(stats.cache_path).glob("*.iterate-*.nbi"))
