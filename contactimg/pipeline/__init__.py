"""The chains behind the commands: a folder or a scene goes in, tables, figures and files come out.

Read in this order, each module using only those before it: `inputs` (reference, asperities and loads of a
scene), `results` (tables and figures of a command, a calibration), `each_frame` (the one loop over frames),
`frame` (measure one frame), `pooled_background` (the background that the frames of a series share),
`measured_series` (pose and forces of frames whose tables stay on the disk, written to files a few at a time),
`series` (measure a series frame by frame), `pictures` (contacts drawn on their frames), `calibrate` (the
paper's calibrations), `check` (contacts drawn into the frames, and found), `predict` (effects that a scene
calls for, model contacts at given loads), `simulate` (synthetic series), `overlay` (measured against
predicted contacts), `analyse` (several runs together), `tradeoff` (accuracy against computing time), `export`
(a run for other programs).
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
