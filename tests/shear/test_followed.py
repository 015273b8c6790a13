"""Contacts by asperity from small tables: places, laws, and input that gives no law."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_series import TINY, write_small_series

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.pipeline.analyse.places import open_place
from contactimg.pipeline.analyse.sheared import analyse_shear
from contactimg.pose.fit import common_shift
from contactimg.shear.followed import fit_beta, fit_shear_laws, follow_contacts
from contactimg.shear.laws import fit_decrease
from contactimg.tables import CONTACTS, FRAMES, LOADS, Status

BETA = 5e-17
TANGENTIAL = np.array([0.0, 4e-4, 7e-4, 1e-3])
ASPERITIES = pd.DataFrame({"x_m": [0.0, 1e-4, 2e-4, 3e-4], "y_m": 0.0})
NAMES = [f"f{k}" for k in range(4)]


def tables(area0=(1e-9, 2e-9, 4e-9), missing=()):
    """Exact contacts that move by 1 um for each 0.1 mN and shrink as q_i = Q A_i/sum A says."""
    area0, rows = np.asarray(area0), []
    for k, load in enumerate(TANGENTIAL):
        shrunk = 1 - BETA * area0**-2.5 * (load * area0 / area0.sum()) ** 2
        for i, (start, part) in enumerate(zip(area0, shrunk, strict=True)):
            if (k, i) not in missing:
                half = np.sqrt(start / np.pi)
                rows.append(
                    {
                        "frame": NAMES[k], "asperity": i, "x_m": 1e-4 * i + 2e-6 + 1e-2 * load, "y_m": 1e-6,
                        "radius_m": half * np.sqrt(part), "radius_std_m": 1e-9, "area_m2": start * part,
                        "semi_major_m": half, "semi_minor_m": half * part, "angle_rad": np.pi / 2,
                    }
                )  # fmt: skip
    contacts = CONTACTS.conform(pd.DataFrame(rows))
    areas = contacts.groupby("frame")["area_m2"].sum().reindex(NAMES).to_numpy()
    frames = FRAMES.conform(
        pd.DataFrame({"frame": NAMES, "load_N": 0.1, "n_contacts": 3, "area_m2": areas, "area_std_m2": 1e-13})
    )
    loads = LOADS.conform(pd.DataFrame({"frame": NAMES, "load_N": 0.1, "tangential_N": TANGENTIAL}))
    return contacts, frames, loads


def test_a_missing_contact_is_expected_where_it_and_the_others_say():
    contacts, frames, loads = tables(missing={(0, 1), (3, 1)})
    followed = follow_contacts(contacts, frames, loads, ASPERITIES).set_index(["asperity", "frame"])
    assert len(followed) == 12  # the fourth asperity never touches
    assert followed.loc[1, "touches"].tolist() == [False, True, True, False]
    # 2 um beside the asperity and 10 um moved with the others
    assert followed.loc[(1, "f3"), "x_m"] == pytest.approx(1e-4 + 2e-6 + 10e-6)
    assert followed.loc[(1, "f3"), "y_m"] == pytest.approx(1e-6)
    assert np.isnan(followed.loc[(1, "f3"), "radius_m"])
    # displacements count from the first frame in which it touches
    assert followed.loc[1, "displacement_x_m"].to_numpy() == pytest.approx(
        [np.nan, 0, 3e-6, np.nan], nan_ok=True
    )
    assert followed.loc[0, "displacement_x_m"].to_numpy() == pytest.approx(1e-2 * TANGENTIAL)


def test_a_frame_without_contacts_keeps_the_places_of_the_frame_before():
    contacts, frames, loads = tables(missing={(2, 0), (2, 1), (2, 2)})
    followed = follow_contacts(contacts, frames, loads, ASPERITIES).set_index(["asperity", "frame"])
    assert followed.loc[(0, "f2"), "x_m"] == pytest.approx(followed.loc[(0, "f1"), "x_m"])
    failed = frames.assign(n_contacts=frames["n_contacts"].mask(frames["frame"] == "f2"))
    assert "f2" not in follow_contacts(contacts, failed, loads, ASPERITIES)["frame"].tolist()


def test_contacts_of_a_frame_without_a_pose_are_not_followed():
    contacts, frames, loads = tables()
    lost = frames.assign(status=frames["status"].mask(frames["frame"] == "f2", Status.NO_POSE))
    followed = follow_contacts(contacts, lost, loads, ASPERITIES)
    assert followed["frame"].unique().tolist() == ["f0", "f1", "f3"]


def test_a_value_of_unknown_uncertainty_is_not_taken_for_exact():
    contacts, frames, loads = tables()
    # the first two frames lie 1 and 2 of 5e-12 m^2 off; one of unknown uncertainty is no better than they
    areas = frames["area_m2"] + np.array([5e-12, 10e-12, 0.0, 0.0])
    frames = frames.assign(area_m2=areas, area_std_m2=[np.nan, 5e-12, 5e-12, 5e-12])
    followed = follow_contacts(contacts, frames, loads, ASPERITIES)
    law = fit_shear_laws(followed, frames).total
    assert law.start.std == pytest.approx(fit_decrease(TANGENTIAL, areas).start.std)
    assert law.start.std > 2e-12
    # of the contacts likewise
    one = contacts["asperity"].eq(1) & contacts["frame"].eq("f0")
    unknown = contacts.assign(radius_std_m=contacts["radius_std_m"].mask(one))
    found = fit_shear_laws(follow_contacts(unknown, frames, loads, ASPERITIES), frames).contacts
    assert found["area_std"][1] == pytest.approx(
        fit_decrease(TANGENTIAL, contacts.loc[contacts["asperity"] == 1, "area_m2"]).start.std
    )


def test_exact_contacts_give_the_laws_that_made_them():
    contacts, frames, loads = tables()
    laws = fit_shear_laws(follow_contacts(contacts, frames, loads, ASPERITIES), frames)
    law = fit_beta([laws])
    assert law.beta.value == pytest.approx(BETA, rel=1e-9)
    assert law.exponent.value == pytest.approx(-1.5, abs=1e-7)
    # half-axes: a beta A^(-5/2) (A/sum A)^2 Q^2 = beta Q^2/(sqrt(pi) (sum A)^2), the same for all
    assert laws.along.rate.value == pytest.approx(BETA / np.sqrt(np.pi) / 7e-9**2, rel=1e-9)
    assert laws.across.rate.value == pytest.approx(0.0, abs=1e-12)
    assert laws.total.start.value == pytest.approx(7e-9)
    # turned by a right angle the two change places; the wrong direction must show
    turned = fit_shear_laws(follow_contacts(contacts, frames, loads, ASPERITIES), frames, direction=np.pi / 2)
    assert turned.across.rate.value == pytest.approx(laws.along.rate.value, rel=1e-9)


def test_what_contacts_share_widens_beta():
    contacts, frames, loads = tables()
    followed = follow_contacts(contacts, frames, loads, ASPERITIES)
    laws, wider = (fit_shear_laws(followed, frames.assign(area_std_m2=std)) for std in (1e-13, 1e-10))
    narrow, wide = fit_beta([laws]).beta, fit_beta([wider]).beta
    with pytest.raises(InputError, match="one normal load or more, got none"):
        fit_beta([])
    assert wide.std == pytest.approx(BETA * wider.total.rate.std / wider.total.rate.value, rel=0.01)
    assert wide.std > 10 * narrow.std


def test_contacts_that_touch_in_no_common_frame_have_no_mean_axes():
    contacts, frames, loads = tables(missing={(0, 0), (1, 1), (2, 2)})
    laws = fit_shear_laws(follow_contacts(contacts, frames, loads, ASPERITIES), frames)
    assert laws.along is None
    assert len(laws.contacts) == 3


def test_disks_have_no_half_axes():
    contacts, frames, loads = tables()
    disks = contacts.assign(angle_rad=np.nan, semi_major_m=contacts["radius_m"])
    laws = fit_shear_laws(follow_contacts(disks, frames, loads, ASPERITIES), frames)
    assert laws.along is None
    assert laws.across is None
    assert len(laws.contacts) == 3


def test_too_few_frames_are_refused_in_one_sentence():
    contacts, frames, loads = tables()
    loads.loc[1:, "tangential_N"] = [np.nan, np.nan, 0.01]
    with pytest.raises(InputError, match="need 3 frames of one normal load with a tangential load, got 2"):
        fit_shear_laws(follow_contacts(contacts, frames, loads, ASPERITIES), frames)


def test_a_common_shift_is_found_among_others(rng):
    targets = rng.uniform(0, 1, (60, 2))
    points = targets[:40] + np.array([0.07, -0.02]) + rng.normal(0, 1e-3, (40, 2))
    points[:4] = rng.uniform(0, 1, (4, 2))
    # the median of 36 places known to 1e-3
    assert common_shift(points, targets, near=0.01, far=0.1) == pytest.approx([0.07, -0.02], abs=1e-3)
    assert common_shift(points + 5, targets, near=0.01, far=0.1).tolist() == [0.0, 0.0]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A run of the tiny series, which states no tangential loads."""
    folder = write_small_series(tmp_path_factory.mktemp("tiny") / "series", TINY)
    assert main(["process", str(folder), "--quiet", "--no-pictures", "--workers", "1"]) in (0, 1)
    return open_place(folder / "contactimg_out")


def shear_of(place):
    notes = []
    return analyse_shear([place], notes, load_tolerance=0.05), notes


def test_runs_without_tangential_loads_have_the_table_alone(tiny):
    found, notes = shear_of(tiny)
    assert (len(found.followed) > 0, found.laws, found.beta, [*found.rows()], notes) == (
        True,
        (),
        None,
        [],
        [],
    )
    assert "place" not in found.table()[1]


def test_rows_of_several_places_have_the_name_of_theirs(tiny):
    found = analyse_shear([tiny, replace(tiny, name="other")], [], load_tolerance=0.05)
    assert found.followed["place"].unique().tolist() == [tiny.name, "other"]
    schema, table = found.table()
    assert (table.columns[-1], list(schema.columns)[-1]) == ("place", "place")


def test_runs_without_asperities_have_nothing_but_a_sentence(tiny):
    bare = replace(tiny, asperities=None)
    found, notes = shear_of(bare)
    assert (len(found.followed), notes) == (0, [])
    stated = replace(bare, loads=tiny.loads.assign(tangential_N=0.1))
    assert shear_of(stated)[1] == [f"{tiny.name}: no laws under shear: no contact has an asperity"]


def test_loads_that_allow_no_law_are_named(tiny):
    # three normal loads, each with one frame
    found, notes = shear_of(replace(tiny, loads=tiny.loads.assign(tangential_N=[0.0, 0.001, 0.002])))
    assert not found.laws
    assert len(notes) == 1
    assert "laws under shear need 3 frames of one normal load with a tangential load, got 1" in notes[0]
    # frames that slide do not count
    slid = tiny.loads.assign(tangential_N=[0.0, 0.001, 0.002], velocity_m_s=1e-3)
    assert shear_of(replace(tiny, loads=slid))[1] == [
        f"{tiny.name}: no laws under shear: no frame at rest has a normal and a tangential load"
    ]
    # equal loads tell no law
    equal = tiny.loads.assign(load_N=0.1, tangential_N=0.001)
    found = replace(tiny, frames=tiny.frames.assign(load_N=0.1), loads=equal)
    assert "two or more different tangential loads, got 1" in shear_of(found)[1][0]
    # nor do loads that are not known
    assert shear_of(replace(tiny, loads=tiny.loads.assign(tangential_N=[0.0, np.nan, np.nan])))[1] == []
