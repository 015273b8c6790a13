"""Contrast and blur, which all contacts of a frame share: found where they show, honest where not."""

import numpy as np
import pandas as pd
import pytest
from frame_sums import total_area, total_force
from scipy import stats

from contactimg.errors import InputError
from contactimg.files import read_frames, read_scene
from contactimg.frame import Frame
from contactimg.imaging.fit import unseen_contrast
from contactimg.imaging.fit.disks import FittedDisks, render_disks
from contactimg.imaging.fit.pooling import pool_optics
from contactimg.imaging.fit.problem import RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.fit.shared_optics import OpticsPrior, disk_scores, settle_optics
from contactimg.imaging.fit.shared_scores import SharedScores
from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.noise import Noise
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.limits import FEW
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.mechanics import hertz
from contactimg.pipeline.frame import measure_frame
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.prediction import predict_contacts
from contactimg.render import render_contacts, render_reference
from contactimg.scene import scene_from_dict
from contactimg.tables import Flag

# SA+ on a fifth of its area: the loads of the whole pattern press it as far as these do
SIDE = 0.004
SERIES = {
    "indenter": {"radius_m": 0.1288, "apex_m": [SIDE / 2, SIDE / 2]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": SIDE, "seed": 5},
    "camera": {"pixel_size_m": 6.0e-6},
    "effects": {"model": "paper"},
    "simulate": {
        "loads_N": [1e-5, 1e-4, 1e-3, 1e-2, 0.1],
        "shape": [680, 700],
        "vignetting": 0.15,
        "texture": 0.02,
        "light_drift": 0.02,
        "position_drift_px": 0.3,
        "electrons_per_level": 20,
        "read_noise_electrons": 10,
        "seed": 5,
    },
}


def solved(load, side):
    """Contacts of the model at a load on a square of a side, with the radius of each sphere."""
    data = {section: dict(keys) for section, keys in SERIES.items()}
    data["indenter"]["apex_m"], data["asperities"]["side_m"] = [side / 2, side / 2], side
    scene = scene_from_dict(data)
    asperities = need_asperities(scene, "a test")
    sites = contact_sites(asperities, scene)["radius_m"].to_numpy()
    table = predict_contacts(scene, asperities, load=load).contacts
    return data, table, sites[table["asperity"].to_numpy(int)]


@pytest.fixture(scope="module", params=[1.4, 2.5])
def series(request, tmp_path_factory):
    """A series at a blur: its run, its truth, and the blur."""
    data = {section: dict(keys) for section, keys in SERIES.items()}
    data["simulate"]["blur_px"] = request.param
    scene = scene_from_dict(data)
    folder = tmp_path_factory.mktemp("series") / "frames"
    folder.mkdir()
    write_simulation(scene, need_asperities(scene, "a test"), folder)
    return measure_series(read_scene(folder), workers=1), pd.read_csv(folder / "truth.csv"), folder


def test_every_frame_of_a_series_is_right_and_says_how_right(series):
    run, truth, _ = series
    for row in run.frames.to_dict("records"):
        true = truth[truth["frame"] == row["frame"]]
        area, force = true["area_m2"].sum(), row["load_N"]
        assert abs(row["area_m2"] - area) < 3 * row["area_std_m2"]
        assert abs(row["force_sum_N"] - force) < 3 * row["force_sum_std_N"]
        # measured on three patterns: within 6 % of the force from 0.1 mN on, 1.5 % from 1 mN, 1 % from 10 mN;
        # the one contact of 10 uN is hardly wider than a pixel and only weighed
        bound = np.interp(row["load_N"], [1e-4, 1e-3, 1e-2], [0.08, 0.025, 0.01])
        if row["load_N"] >= 1e-4:
            assert abs(row["force_sum_N"] / force - 1) < bound
        # what the wide blur hides of the edges is more, and is not bounded here
        contacts = run.contacts[run.contacts["frame"] == row["frame"]]
        stated = total_force(without_edge(contacts)).std / force
        assert stated < (0.6 if row["load_N"] < 1e-4 else bound)


def test_the_contrast_of_small_contacts_comes_from_the_frames_with_large_ones(series):
    run, _, _ = series
    contrast = run.frames["contrast"].to_numpy()
    assert contrast[:2] == pytest.approx(contrast[-1], rel=0.01)
    small = run.contacts[run.contacts["frame"] == run.frames["frame"][0]]
    assert (small["flags"] & int(Flag.NO_PLATEAU)).all()
    assert "too small to show their brightness" in run.frames["message"][0]
    large = run.contacts[run.contacts["frame"] == run.frames["frame"].iloc[-1]]
    assert not (large["flags"] & int(Flag.NO_PLATEAU)).any()


def test_a_frame_alone_knows_that_it_does_not_know(series):
    run, truth, folder = series
    reference = read_frame(folder / "reference.tif")
    for name in ("frame_2.tif", "frame_3.tif"):
        true = truth[truth["frame"] == name]
        alone = measure_frame(read_frame(folder / name), reference, pixel_size=6e-6)
        found = assign_hertz(alone)
        together = run.contacts[run.contacts["frame"] == name]
        # the uncertainty is that of the frame's own contrast, common to all contacts
        assert alone["radius_std_px"].median() > 1.5 * together["radius_std_px"].median()
        assert abs(total_area(found).value - true["area_m2"].sum()) < 3 * total_area(found).std
        assert abs(total_force(found).value - true["force_N"].sum()) < 3 * total_force(found).std


def test_a_contrast_and_a_blur_that_are_handed_over_are_used(series):
    run, truth, folder = series
    blur = read_scene(folder).simulate.blur_px
    known = measure_frame(
        read_frame(folder / "frame_2.tif"),
        read_frame(folder / "reference.tif"),
        pixel_size=6e-6,
        contrast=float(run.frames["contrast"].iloc[-1]),
        blur_px=blur,
    )
    true = truth[truth["frame"] == "frame_2.tif"]
    assert known["area_m2"].sum() == pytest.approx(true["area_m2"].sum(), rel=0.15)
    known = without_edge(known)  # whether it is plain was not handed over
    assert (known["radius_std_px"] / known["radius_px"]).median() < 0.05


def read_frame(path):
    return read_frames(path)[0]


def without_edge(contacts):
    """Without what the frame does not decide about its edges, which are those assumed."""
    variance = contacts["radius_std_px"] ** 2 - contacts["edge_shift_px"] ** 2
    std = np.sqrt(variance.clip(lower=0.0))
    scale = contacts["radius_m"] / contacts["radius_px"]
    return contacts.assign(radius_std_px=std, radius_std_m=std * scale, edge_shift_px=0.0)


def own_part(contacts):
    """Relative uncertainty of each radius without what all contacts of the frame share."""
    shared = contacts[["contrast_shift_px", "blur_shift_px"]].to_numpy()
    own = contacts["radius_std_px"].to_numpy() ** 2 - np.sum(shared**2, axis=1)
    return np.sqrt(own) / contacts["radius_px"].to_numpy()


def assign_hertz(contacts):
    R = 1e-4 * 0.1288 / (1e-4 + 0.1288)
    force = hertz.load(contacts["radius_m"].to_numpy(), sphere_radius=R, contact_modulus=4e6)
    return contacts.assign(force_N=force)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "side", "shape"), [(0.02, SIDE, [460, 590]), (0.05, 0.75 * SIDE, [510, 530])]
)
def test_stated_errors_of_the_sums_cover_the_errors(load, side, shape):
    """20 frames of one set of contacts, each with noise, texture and place of its own."""
    series, contacts, radii = solved(load, side)
    true_area, true_force = contacts["area_m2"].sum(), contacts["force_N"].sum()
    pulls, claims = [], []
    for seed in range(20):
        simulated = series["simulate"] | {"blur_px": 1.4, "seed": seed, "shape": shape}
        scene, rng = scene_from_dict(series | {"simulate": simulated}), np.random.default_rng(seed)
        frame = render_contacts(contacts, scene, rng=rng, sphere_radius=radii).frame
        measured = measure_frame(frame, render_reference(scene, rng=rng), pixel_size=6e-6)
        table = assign_hertz(without_edge(measured))
        area, force = total_area(table), total_force(table)
        pulls.append([(area.value - true_area) / area.std, (force.value - true_force) / force.std])
        alone = total_force(
            table.drop(columns=["contrast_shift_px", "blur_shift_px"]).assign(
                radius_std_m=own_part(table) * table["radius_m"]
            )
        )
        claims.append(alone.std / force.std)
    mean, std = np.mean(pulls, axis=0), np.std(pulls, axis=0, ddof=1)
    # the standard deviation of 20 normal deviates lies within 0.51 and 1.56 in 99.9 of 100 cases
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 19) / 19)
    assert ((std > low) & (std < high)).all()
    # their mean within 2.7/sqrt(20) = 0.6 in 99.3; what is asked for is less than half a standard deviation
    # of bias
    assert (np.abs(mean) < 0.6).all()
    # without what all contacts share the sums would claim too much
    assert np.mean(claims) < 0.8


def blurred_points(radius, contrast, blur, *, noise=1.0, seed=0, n=5):
    """A float frame of ``n`` x ``n`` equal disks without any background structure, and its reference."""
    rng = np.random.default_rng(seed)
    side = 40
    x, y = np.meshgrid(side * (np.arange(n) + 0.5), side * (np.arange(n) + 0.5))
    disks = np.column_stack([x.ravel(), y.ravel(), np.full(n * n, radius), np.full(n * n, contrast)])
    disks[:, :2] += rng.uniform(-0.5, 0.5, (n * n, 2))
    shape = (side * n, side * n)
    image = 100.0 + render_disks(disks, float(np.hypot(blur, PIXEL_VARIANCE**0.5)), shape)
    return image + rng.normal(0, noise, shape), 100.0 + rng.normal(0, noise, shape), disks


def test_many_small_contacts_show_together_what_one_does_not(monkeypatch):
    monkeypatch.setattr(unseen_contrast, "KURTOSIS_STD", 0.0)
    image, reference, _ = blurred_points(2.0, 80.0, 1.5)
    many = measure_image(image, reference, polarity="bright")
    assert many.optics.contrast == pytest.approx(80.0, abs=3 * many.optics.contrast_std)
    assert many.optics.blur_px == pytest.approx(1.5, abs=3 * many.optics.blur_std_px)
    known = SharedOptics(80.0, 0.01, 0.0, 1.5, 1e-4)
    one, all_ = (
        measure_image(image[:side, :side], reference[:side, :side], polarity="bright", optics=known)
        for side in (40, 200)
    )
    # 25 contacts know five times as much; noise decides what a single one seems to know
    ratio = one.own_optics.contrast_relative_std / all_.own_optics.contrast_relative_std
    assert ratio == pytest.approx(5.0, rel=0.3)
    assert many.resolved
    assert not one.resolved


def test_however_many_small_contacts_show_no_more_than_the_point_spread_function_is_known():
    """Light and width of a small spot do not tell contrast from radius; only a known kurtosis does."""
    image, reference, _ = blurred_points(2.0, 80.0, 1.5)
    many = measure_image(image, reference, polarity="bright")
    # at equal light and variance the kurtosis is u^2, u = (a^2/4)/(s^2 + a^2/4): the middle 68 % of the
    # contrasts between the brightest light and ten times that, by the kurtosis alone
    blur_variance = 1.5**2 + PIXEL_VARIANCE
    lowest = np.log(-np.expm1(-0.5 * 2.0**2 / blur_variance))
    change = np.linspace(lowest, lowest + np.log(10.0), 4001)
    kurtosis = (np.exp(-change) / (blur_variance + 1.0)) ** 2
    off = (kurtosis - (blur_variance + 1.0) ** -2) / unseen_contrast.KURTOSIS_STD
    share = np.cumsum(np.exp(-0.5 * off**2))
    ends = np.interp([0.1587, 0.8413], share / share[-1], change)
    expected = np.sqrt(np.mean(ends**2))  # 0.28
    assert many.own_optics.contrast_relative_std == pytest.approx(expected, rel=0.2)
    assert not many.resolved
    assert "too small to show their brightness" in many.message


def test_radius_follows_a_wrong_contrast_as_stated():
    # light goes as contrast x radius^2: a contact much smaller than the blur shrinks by half of what the
    # contrast is too high
    image, reference, _ = blurred_points(0.8, 80.0, 1.5, noise=0.1)
    radii = []
    for contrast in (80.0, 84.0):
        given = SharedOptics(contrast, 0.01, 0.0, 1.5, 1e-4)
        found = measure_image(image, reference, polarity="bright", optics=given)
        assert found.optics.contrast == pytest.approx(contrast, rel=1e-3)
        radii.append(found.disks["radius_px"].to_numpy())
    assert np.log(radii[1] / radii[0]) == pytest.approx(-0.5 * np.log(84 / 80), rel=0.15)
    shift = found.disks["contrast_shift_px"] / found.disks["radius_px"]
    assert found.optics.contrast_std <= 0.01
    assert shift.to_numpy() == pytest.approx(-0.5 * found.optics.contrast_relative_std, rel=0.15)


def test_radius_std_holds_the_shares_of_contrast_and_blur():
    image, reference, disks = blurred_points(1.2, 80.0, 1.5)
    found = measure_image(image, reference, polarity="bright").disks
    shared = found[["contrast_shift_px", "blur_shift_px", "edge_shift_px"]].to_numpy()
    assert (found["radius_std_px"].to_numpy() ** 2 > np.sum(shared**2, axis=1)).all()
    # and they matter more than the noise of each contact
    assert np.median(np.linalg.norm(shared, axis=1) / found["radius_std_px"]) > 0.7
    assert len(found) == len(disks)


def test_pooling_weighs_by_uncertainty_and_widens_by_scatter():
    exact = [SharedOptics(1.2, 0.012, 0.0, 1.4, 0.01), SharedOptics(1.2, 0.012, 0.0, 1.4, 0.01)]
    pooled = pool_optics(exact)
    # two equal measurements: half the variance
    assert pooled.contrast_relative_std == pytest.approx(0.01 / np.sqrt(2), rel=1e-6)
    assert pooled.blur_std_px == pytest.approx(0.01 / np.sqrt(2), rel=1e-6)
    apart = [SharedOptics(level, 0.001, 0.0, 1.4, 0.01) for level in (1.0, 1.1, 1.2, 1.1)]
    # what one more frame scatters is the spread of those seen, far beyond their own uncertainties: the
    # logarithms spread by 0.0745 (n - 1 in the denominator), of the mean itself a quarter of the variance
    logs = np.log([1.0, 1.1, 1.2, 1.1])
    expected = np.std(logs, ddof=1) * np.sqrt(1.25)
    assert pool_optics(apart).contrast_relative_std == pytest.approx(expected, rel=0.02)
    assert pool_optics([SharedOptics(1.0, 0.5)]) is None


def test_one_frame_far_off_does_not_spoil_the_pool():
    frames = [SharedOptics(1.25, 0.005, 0.0, 1.4, 0.01) for _ in range(9)]
    pooled = pool_optics([*frames, SharedOptics(2.5, 0.01, 0.0, 3.0, 0.02)])
    assert pooled.contrast == pytest.approx(1.25, rel=0.02)
    assert pooled.blur_px == pytest.approx(1.4, rel=0.02)


def test_threshold_radii_follow_the_contrast_too():
    image, reference, _ = blurred_points(6.0, 80.0, 1.4, noise=0.5)
    radii = [
        measure_image(
            image, reference, method="threshold", polarity="bright", optics=SharedOptics(contrast, 4.0)
        )
        .disks["radius_px"]
        .mean()
        for contrast in (80.0, 84.0)
    ]
    found = measure_image(
        image, reference, method="threshold", polarity="bright", optics=SharedOptics(80.0, 4.0)
    ).disks
    # level 40 -> 42 on a rim of slope 80/(sqrt(2 pi) 1.43): 0.09 px; pixels are counted whole
    assert radii[1] - radii[0] == pytest.approx(-0.09, abs=0.02)
    assert found["contrast_shift_px"].mean() == pytest.approx(-0.09, abs=0.02)


@pytest.mark.parametrize("wrong", ["6", None, float("nan"), -1.0, 0.0, True, 1 + 2j, [6e-6]])
def test_a_pixel_size_that_is_none_is_one_sentence(wrong):
    with pytest.raises(InputError, match="pixel_size_m must be"):
        measure_frame(np.zeros((20, 20)), pixel_size=wrong)


@pytest.mark.parametrize("option", ["contrast", "blur_px"])
def test_contrast_and_blur_must_be_positive_numbers(option):
    for wrong in ("90", float("inf"), 0.0):
        with pytest.raises(InputError, match=f"{option} must be"):
            measure_frame(np.zeros((20, 20)), pixel_size=6e-6, **{option: wrong})


def test_contrast_is_in_grey_levels_of_the_frame_whatever_the_depth_of_the_reference():
    image, reference, _ = blurred_points(6.0, 80.0, 1.4)
    frame = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    plain = np.clip(np.rint(reference), 0, 255).astype(np.uint8)
    same = measure_image(frame, plain, polarity="bright")
    deep = measure_image(frame, plain.astype(np.uint16) * 257, polarity="bright")
    assert deep.status == same.status == "ok"
    assert deep.contrast == pytest.approx(same.contrast, rel=5e-3)
    assert deep.noise == pytest.approx(same.noise, rel=0.05)
    assert deep.disks["radius_px"].to_numpy() == pytest.approx(same.disks["radius_px"].to_numpy(), abs=0.02)


def test_a_frame_object_keeps_its_name():
    image, reference, _ = blurred_points(6.0, 80.0, 1.4, n=2)
    table = measure_frame(Frame(image, "one.tif"), Frame(reference), pixel_size=1e-6)
    assert set(table["frame"]) == {"one.tif"}


def test_scores_without_information_do_not_disagree():
    count = FEW
    information = np.zeros((count, 2, 2))
    information[:, 1, 1] = 1.0  # of the blur alone
    nothing = np.zeros((count, 2))
    scores = SharedScores(nothing, information, np.zeros((count, 4, 2)), np.zeros((count, 4)), nothing)
    score, total, factor, _ = scores.total(np.array([0, 1]))
    assert score == pytest.approx(0.0)
    assert total == pytest.approx(np.diag([0.0, count]))
    assert factor == 1.0


def test_a_disk_fitted_with_another_prior_says_nothing_rather_than_less():
    information = np.diag([100.0, 100.0, 100.0, 1e-3, 400.0])[None]  # of the contrast less than the prior has
    disk = np.array([[20.0, 20.0, 2.0, 80.0]])
    fit = FittedDisks(
        disk, np.full((1, 4), 0.01), np.ones(1), np.full(1, 100), 1.5, np.zeros((40, 40), np.float32),
        information, np.zeros(1), np.ones(1),
    )  # fmt: skip
    left = disk_scores(fit, ContrastPrior(80.0, 1.0, 1.0)).information[0]
    assert np.linalg.eigvalsh(left).min() >= 0.0
    assert left[1, 1] == pytest.approx(400.0)


def test_a_disk_without_information_does_not_fly_off():
    """Its derivatives by contrast and blur are quotients of next to nothing."""
    count, blur, contrast = 12, 1.5, 80.0
    disks = np.column_stack([np.arange(count) * 30.0, np.full(count, 20.0), np.full(count, 10.0)])
    disks = np.column_stack([disks, np.full(count, contrast)])
    information = np.tile(np.diag([100.0, 100.0, 100.0, 1.0, 400.0]), (count, 1, 1))
    information[-1, :4, :4] = 1e-12 * np.eye(4)
    information[-1, RADIUS, 4] = information[-1, 4, RADIUS] = 1e-3
    problem = FitProblem(
        np.zeros((40, 40), np.float32), Noise(4.0), ContrastPrior(contrast, 1.0, 1.0), largest_contrast=200.0
    )
    fit = FittedDisks(
        disks, np.full((count, 4), 0.01), np.ones(count), np.full(count, 100), blur, problem.image,
        information, np.full(count, 1.6), np.ones(count),
    )  # fmt: skip
    prior = OpticsPrior(np.array([np.log(contrast), blur]), np.diag([1e4, 1.0]))
    joint = settle_optics(problem, fit, prior, inflation=np.ones(count), wide_contrast=contrast)
    assert joint.fit.blur != blur
    assert np.abs(joint.fit.disks[:, RADIUS] / disks[:, RADIUS] - 1.0).max() < 0.1
