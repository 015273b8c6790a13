"""Sums over the contacts of a frame and what too small contacts add to them, as `fill_forces` takes them."""

import numpy as np

from contactimg.forces import Total, total, unseen_sum, visible_areas


def total_area(contacts, **stds) -> Total:
    """Area of contact that the image shows, m^2."""
    areas = visible_areas(contacts)
    return total(contacts, areas, 2 * areas, **stds)


def total_force(contacts, **stds) -> Total:
    """Sum of forces by Hertz's law, N."""
    return total(contacts, contacts["force_N"], 3 * contacts["force_N"], **stds)


def unseen_area(contacts, smallest) -> Total:
    """Area of the contacts below the limit (m), m^2."""
    return unseen_sum(contacts, np.pi * contacts["radius_m"] ** 2, smallest, power=1.0)


def unseen_force(contacts, smallest) -> Total:
    """Force on the contacts below the limit (m), N."""
    return unseen_sum(contacts, contacts["force_N"], smallest, power=1.5)
