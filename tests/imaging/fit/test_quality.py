"""From fitted disks to a table of contacts."""

from dataclasses import replace

import numpy as np
from contactimg.imaging.fit.quality import FrameFit, _tabulate

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.disks import fit_disks, render_disks
from contactimg.imaging.fit.problem import RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.fit.shared_optics import JointFit


def test_a_disk_of_which_nothing_is_known_is_no_contact(rng):
    """Without information its uncertainty is 0: it is not one that stands out infinitely."""
    disks = np.array([[30.0, 30.0, 6.0, 100.0], [70.0, 30.0, 5.0, 100.0]])
    image = render_disks(disks, 1.4, (60, 100)) + rng.normal(0, 2, (60, 100)).astype(np.float32)
    problem = FitProblem(image, Noise(4.0), ContrastPrior(100.0, 5.0))
    fit = fit_disks(problem, disks, blur=1.4)
    std = fit.std.copy()
    std[1, RADIUS] = 0.0
    fit = replace(fit, std=std)
    joint = JointFit(fit, 100.0, 5.0, 100.0, np.eye(2), np.eye(2), radius_shifts=np.zeros((2, 2)))
    contacts, rows = _tabulate(FrameFit(problem, fit, np.zeros((0, 3)), 1.0, None, joint))
    assert rows.tolist() == [0]
    assert contacts["radius_std_px"].tolist() == [std[0, RADIUS]]
