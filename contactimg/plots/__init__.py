"""Draw figures: tables in, matplotlib axes out; ``ax=`` draws on existing axes.

Lengths are in um or mm, forces in mN, areas in mm^2, moduli and shear stresses in MPa, pressures in kPa.
Read in this order: `images` and `overlay` (contacts on frames), `laws` (analysis), `calibration`, `tradeoff`,
`captions`, `numbers`, `axes`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
