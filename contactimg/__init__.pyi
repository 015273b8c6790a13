__version__: str

from .errors import ContactimgError as ContactimgError
from .errors import ConvergenceError as ConvergenceError
from .errors import FrameError as FrameError
from .errors import InputError as InputError
from .errors import ModelRangeError as ModelRangeError
from .files import read_frames as read_frames
from .files import read_scene as read_scene
from .frame import Frame as Frame
from .pose import Pose as Pose
from .scene import Scene as Scene
from .scene import scene_from_dict as scene_from_dict
from .tables import Flag as Flag
from .mechanics import hertz as hertz
from .mechanics import jkr as jkr
from .models.interacting import solve_interacting as solve_interacting
from .models.interacting import solve_loads as solve_loads
from .render import Rendered as Rendered
from .render import render_contacts as render_contacts
from .render import render_frame as render_frame
from .render import render_reference as render_reference
from .surfaces import check_asperities as check_asperities
from .surfaces import composite_apexes as composite_apexes
from .surfaces import generate_asperities as generate_asperities
