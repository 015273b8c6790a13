"""What finite strain changes in the contact of a sphere: estimated, not part of any law of force.

`contactimg.effects.plan.unmodelled_effects` estimates it for the contacts of a scene.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

STRAIN_RATIO = (0.0, 0.052, 0.104, 0.209, 0.314, 0.421, 0.528, 0.637, 0.749)
OVER_HERTZ = (1.0, 0.997, 0.993, 0.988, 0.991, 1.000, 1.024, 1.057, 1.106)
OVER_SPHERE = (1.0, 0.996, 0.988, 0.971, 0.951, 0.926, 0.901, 0.864, 0.808)
"""a/R, and the load of a rigid sphere on incompressible neo-Hookean rubber at this contact radius over that
of Hertz's law and of the exact sphere's: axisymmetric finite elements (`benchmarks/finite_strain.py`), good
to 0.6 %, 1 % at the last."""


def load_over_law(strain: ArrayLike, law: str) -> NDArray[np.float64]:
    """Load at finite strain over that of the law "hertz" or "sphere", at ratios of contact to sphere radius.

    Beyond a ratio of 0.749 the last value stands for at least that much.

    Examples
    --------
    >>> load_over_law([0.1, 0.6], "hertz").round(3).tolist()
    [0.993, 1.046]
    """
    return np.interp(np.asarray(strain, float), STRAIN_RATIO, OVER_SPHERE if law == "sphere" else OVER_HERTZ)
