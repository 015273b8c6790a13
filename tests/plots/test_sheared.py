"""Figures of contacts under a tangential load: what is drawn, and in which units and colours."""

import numpy as np
import pandas as pd

from contactimg.plots import plot_sheared_areas
from contactimg.tables import FOLLOWED


def followed():
    """Two contacts in three frames, the second seen in two of them; tangential loads out of order."""
    rows = [
        {"asperity": k, "frame": f, "load_N": 0.1, "tangential_N": q, "area_m2": area, "touches": area > 0}
        for k, areas in enumerate([(4e-9, 3e-9, 3.5e-9), (1e-10, 0.0, 0.5e-10)])
        for f, q, area in zip("abc", (0.0, -0.02, 0.01), areas, strict=True)
    ]
    return FOLLOWED.conform(pd.DataFrame(rows))


def test_each_contact_is_a_line_over_the_magnitude_of_the_load_coloured_by_its_radius():
    ax = plot_sheared_areas(followed())
    lines, points = ax.collections
    first, second = lines.get_segments()
    assert np.allclose(first, [[0.0, 4000.0], [10.0, 3500.0], [20.0, 3000.0]])
    assert np.allclose(second, [[0.0, 100.0], [10.0, 50.0]])
    # largest radii: sqrt(4000/pi) and sqrt(100/pi) um
    assert np.allclose(lines.get_array(), [35.68, 5.64], atol=0.01)
    assert len(points.get_offsets()) == 5
    assert "mN" in ax.get_xlabel()
    assert ax.get_yscale() == "log"


def test_loads_of_another_normal_load_are_other_lines_and_nothing_is_no_error():
    table = followed().assign(load_N=[0.1, 0.1, 0.2, 0.1, 0.1, 0.2])
    assert len(plot_sheared_areas(table).collections[0].get_segments()) == 4
    assert not plot_sheared_areas(followed().iloc[:0]).collections
