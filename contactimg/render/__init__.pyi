from .frames import Rendered as Rendered
from .frames import render_contacts as render_contacts
from .frames import render_frame as render_frame
from .frames import render_reference as render_reference
from .frames import render_smooth_contact as render_smooth_contact
