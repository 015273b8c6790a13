"""Where the camera looks: the similarity between pixels and sample coordinates, and its fit.

Read in this order: `pose` (`Pose`, the similarity itself), `pairs` (one-to-one pairs of points and targets,
or of contacts), `fit` (contact centres and asperities in, the pose that makes them coincide out: near the
stated pose or anywhere), `apex` (where the indenter stands).
"""

from contactimg.pose.pose import Pose

__all__ = ["Pose"]
