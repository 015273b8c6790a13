"""The scene: one description of an experiment, measured or simulated, validated on entry.

Keys carry their unit (``radius_m``); the attributes of the records do not (``radius``) and hold SI floats,
except pixel lengths (``_px``). An unknown key, a missing key or a value out of range is an `InputError` whose
sentence names the section, the key, the rule, the value and, for an unknown key, the allowed keys.

Read in this order: `sections` (every section with its keys), `scene` (`Scene`, `scene_from_dict` and the
sentence for a broken rule).
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
