"""Classify frames as loading or unloading by the order of their loads."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def classify_branches(load: ArrayLike) -> NDArray[np.str_]:
    """Classify each load as loading or unloading.

    Parameters
    ----------
    load : array_like, shape (n,), N
        In the order in which they were applied.

    Returns
    -------
    ndarray of str, shape (n,)
        "loading" up to the largest load and "unloading" after it, if the loads rise to it and then fall
        monotonically; empty for any other order.

    Examples
    --------
    >>> classify_branches([0.1, 0.2, 0.5, 0.2, -0.01])
    array(['loading', 'loading', 'loading', 'unloading', 'unloading'], dtype='<U9')
    >>> classify_branches([0.2, 0.1, 0.5])
    array(['', '', ''], dtype='<U9')
    """
    P = np.asarray(load, float)
    branch = np.full(P.shape, "", "<U9")
    if P.size:
        top = int(P.argmax())
        if np.all(np.diff(P[: top + 1]) >= 0) and np.all(np.diff(P[top:]) <= 0):
            branch[: top + 1], branch[top + 1 :] = "loading", "unloading"
            if top == 0 and P.size > 1:
                branch[:] = "unloading"
    return branch
