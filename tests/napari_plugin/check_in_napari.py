"""Open a run folder in napari, correct the contacts, save them. Needs the extra `napari`, but no display.

python tests/napari_plugin/check_in_napari.py RUN
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from contactimg.files import read_edits, read_run


def main(folder: str) -> None:
    """The first contact of the run is deleted, the second moved, and one added."""
    from napari.components import ViewerModel
    from npe2 import PluginManager

    manager = PluginManager.instance()
    manager.discover()
    manager.get_manifest("contactimg").validate_imports()
    viewer = ViewerModel()
    viewer.open(folder, plugin="contactimg")
    run = read_run(folder)
    contacts = viewer.layers["contacts"]
    assert len(contacts.data) == len(run.contacts)
    assert viewer.layers["frames"].data.shape[0] == run.frames["n_contacts"].notna().sum()
    contacts.selected_data = {0}
    contacts.remove_selected()
    moved = [points + np.array([0.0, 2.0 * (k == 0), 0.0]) for k, points in enumerate(contacts.data)]
    contacts.data = moved
    contacts.add(moved[1] + np.array([0.0, 0.0, 4.0]), shape_type="ellipse")
    with tempfile.TemporaryDirectory() as place:
        target = str(Path(place) / "edits.csv")
        assert contacts.save(target, plugin="contactimg") == [target]
        edits = read_edits(Path(target))
    assert edits["action"].tolist() == ["exclude", "exclude", "add", "add"], edits
    first, second, third = (run.contacts.iloc[k] for k in range(3))
    np.testing.assert_allclose(edits["x_px"], [first.x_px, second.x_px, second.x_px, third.x_px + 4.0])
    np.testing.assert_allclose(edits["y_px"], [first.y_px, second.y_px, second.y_px + 2.0, third.y_px])


if __name__ == "__main__":
    main(sys.argv[1])
