"""Every command that predicts contacts follows the loading path that the scene states."""

import numpy as np
import pandas as pd
import pytest

from contactimg.files import Run
from contactimg.pipeline.analyse.places import Place, predict_places
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.overlay import compare_run
from contactimg.pose.fit import PoseFit
from contactimg.prediction import predict_contacts
from contactimg.scene import scene_from_dict
from contactimg.tables import CONTACTS, FRAMES, LOADS, Status

LOW, HIGH = 1e-3, 2e-2


@pytest.fixture(scope="module", params=["loading", "unloading"])
def scene(request):
    return scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288, "apex_m": [1e-3, 1e-3]},
            "elastic": {"young_modulus_Pa": 3.0e6, "work_of_adhesion_J_m2": 0.05},
            "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.002, "seed": 3},
            "camera": {"pixel_size_m": 6e-6},
            "effects": {"adhesion": "on"},
            "load": {"path": request.param},
        }
    )


@pytest.fixture(scope="module")
def asperities(scene):
    return need_asperities(scene, "a test")


@pytest.fixture(scope="module")
def frames():
    rows = [{"frame": "a.tif", "load_N": LOW}, {"frame": "b.tif", "load_N": HIGH}]
    return FRAMES.conform(pd.DataFrame(rows).assign(status=Status.OK, message="", n_contacts=9, area_m2=1e-8))


@pytest.fixture(scope="module")
def area(scene, asperities):
    """Area at the lower load, on the stated path and on first loading."""
    history = (HIGH,) if scene.load.path == "unloading" else ()
    stated, first = (
        predict_contacts(scene, asperities, load=LOW, history=before).contacts for before in (history, ())
    )
    if history:
        assert stated["area_m2"].sum() > 1.015 * first["area_m2"].sum()  # contacts are held
    return stated["area_m2"].sum()


def test_overlay_follows_the_path(scene, asperities, frames, area):
    pose = PoseFit(scene.pose((340, 360)), fitted=False, n_points=0, n_matched=0, residual=np.nan)
    run = Run(scene, CONTACTS.empty(), frames, pose)
    predicted = compare_run(run, asperities).predicted["a.tif"]["coupled"]
    assert predicted["area_m2"].sum() == pytest.approx(area, rel=1e-9)


def test_analyse_follows_the_path(scene, asperities, frames, area):
    contacts = CONTACTS.empty().assign(radius_ratio=pd.Series(dtype=float))
    place = Place("here", contacts, frames, scene, None, (1e-3, 1e-3), asperities, LOADS.empty())
    (found,), notes = predict_places([place], "coupled", workers=1)
    assert not notes
    predicted = found.contacts[found.contacts["frame"] == "a.tif"]
    assert predicted["area_m2"].sum() == pytest.approx(area, rel=1e-9)


def test_contacts_do_not_depend_on_the_loads_stated_on_the_way(scene, asperities):
    ways = ((HIGH,), tuple(np.geomspace(HIGH, 1.05 * LOW, 6)))
    direct, slow = (
        predict_contacts(scene, asperities, load=LOW, coupling="asymptotic", history=way).contacts
        for way in ways
    )
    assert direct["asperity"].tolist() == slow["asperity"].tolist()  # in one step two of twelve were lost
    assert direct["radius_m"].to_numpy() == pytest.approx(slow["radius_m"].to_numpy(), rel=1e-8)
