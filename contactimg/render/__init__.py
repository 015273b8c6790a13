"""From contacts to camera frames, with the truth beside them."""

from contactimg.render.frames import (
    Rendered,
    render_contacts,
    render_frame,
    render_reference,
    render_smooth_contact,
)

__all__ = ["Rendered", "render_contacts", "render_frame", "render_reference", "render_smooth_contact"]
