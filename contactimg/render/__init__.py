"""Render contacts as camera frames, together with the true contacts.

In: contacts and a scene with the section ``[simulate]``. Out: a `Rendered` frame with its truth. Read in this
order: `frames` (the functions to call), `contacts` (of textured surfaces, and the wide one of a sphere).
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
