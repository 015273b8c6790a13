"""Render contacts as camera frames, together with the true contacts.

In: contacts and a scene with the section ``[simulate]``. Out: a `Rendered` frame with its truth. Read in this
order: `frames` (the functions to call), `contacts` (textured surfaces), `smooth` (one wide contact).
"""

from contactimg.render.frames import (
    Rendered,
    render_contacts,
    render_frame,
    render_reference,
    render_smooth_contact,
)

__all__ = ["Rendered", "render_contacts", "render_frame", "render_reference", "render_smooth_contact"]
