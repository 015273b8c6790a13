"""The fit: exact on its own model, honest about its error, and able to separate."""

import cv2
import numpy as np
import pandas as pd
import pytest
from contact_frames import Optics, match, render

from contactimg.imaging.fit.disks import FitControl, ModelImage, find_insignificant, fit_disks, render_disks
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem
from contactimg.imaging.fit.residual_light import estimate_halo, subtract_halo
from contactimg.imaging.fit.shared_optics import contrast_prior
from contactimg.imaging.kernels.pairs import find_pairs, overlapping
from contactimg.imaging.kernels.solve import invert_4x4
from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.noise import Noise, NoiseCorrelation, measure_correlation
from contactimg.tables import Flag


def fit(image, start, *, blur, noise=1.0, contrast=100.0, width=10.0, active=None, **options):
    problem = FitProblem(image, Noise(noise**2), ContrastPrior(contrast, width))
    return fit_disks(problem, start, blur=blur, control=FitControl(**options), active=active)


def grid(rng, *, n=6, space=44, radii=(1.5, 12)):
    y, x = (np.mgrid[0:n, 0:n] + 0.5) * space
    a = np.exp(rng.uniform(*np.log(radii), n * n))
    jitter = rng.uniform(-0.5, 0.5, (2, n * n))
    return np.column_stack([x.ravel() + jitter[0], y.ravel() + jitter[1], a, np.full(n * n, 100.0)])


def test_the_model_is_recovered_from_a_poor_start(rng):
    truth = grid(rng)
    image = render_disks(truth, 1.5, (264, 264))
    start = truth + rng.uniform(-0.7, 0.7, truth.shape) * [1, 1, 1, 0]
    start[:, 2] = np.maximum(start[:, 2], 0.8)
    found = fit(image, start, blur=1.2, noise=0.05, width=5.0, iterations=20, robust=False)
    # the table interpolates to 3e-5 of the contrast, and the last step ends at a tenth of 0.05 levels' worth
    # of error
    assert found.blur == pytest.approx(1.5, abs=1e-3)
    assert np.abs(found.disks[:, :3] - truth[:, :3]).max() < 3e-3
    assert np.abs(found.disks[:, 3] - 100.0).max() < 0.5


def test_uncertainty_is_the_scatter_of_repeated_fits(rng):
    truth = grid(rng)
    clean = render_disks(truth, 1.5, (264, 264))
    pulls = []
    for _ in range(12):
        image = clean + rng.normal(0, 3.0, clean.shape).astype(np.float32)
        found = fit(image, truth.copy(), blur=1.5, noise=3.0, free_blur=False)
        pulls.append((found.disks - truth)[:, :3] / found.std[:, :3])
    pulls = np.array(pulls)
    # 12 x 36 x 3 normal deviates: the mean of the squares scatters by sqrt(2/1296) = 4 %, four times that
    assert np.mean(pulls**2) == pytest.approx(1.0, abs=0.16)
    assert np.median(found.chi_square) == pytest.approx(1.0, abs=0.1)


def test_neighbours_share_their_pixels(rng):
    # two touching disks: fitted together they come out right, and their errors are larger than alone
    truth = np.array([[30.0, 30.0, 6.0, 100.0], [42.0, 30.0, 6.0, 100.0], [90.0, 30.0, 6.0, 100.0]])
    image = render_disks(truth, 1.5, (60, 120))
    start = truth + np.array([[0.6, 0.3, -0.5, 0], [-0.4, 0.2, 0.6, 0], [0.3, 0.3, 0.3, 0]])
    found = fit(image, start, blur=1.5, noise=0.1, free_blur=False, iterations=20, robust=False)
    assert np.abs(found.disks[:, :3] - truth[:, :3]).max() < 5e-3
    assert found.std[0, 2] > 1.05 * found.std[2, 2]
    assert len(find_pairs(truth, 4.0)) == 1


def test_an_outlier_loses_its_weight(rng):
    truth = np.array([[30.0, 30.0, 6.0, 100.0]])
    image = render_disks(truth, 1.5, (60, 60)) + rng.normal(0, 1.0, (60, 60)).astype(np.float32)
    image[29:32, 35:38] += 100.0  # a bright grain on the rim
    errors = {
        robust: abs(fit(image, truth.copy(), blur=1.5, free_blur=False, robust=robust).disks[0, 2] - 6.0)
        for robust in (True, False)
    }
    # the grain brings 900 levels to a rim of 2 pi 6 px with 100 levels for each px of radius: a quarter of a
    # pixel
    assert errors[False] > 0.1
    # its own uncertainty is 0.01 px
    assert errors[True] < 0.04


def test_disks_held_fixed_stay(rng):
    truth = grid(rng, n=2)
    image = render_disks(truth, 1.5, (88, 88))
    start = truth + np.array([0.3, 0.3, 0.2, 0])
    moves = np.array([True, False, True, False])
    found = fit(image, start, blur=1.5, active=moves, free_blur=False)
    assert np.array_equal(found.disks[~moves], start[~moves])
    assert np.abs(found.disks[moves] - truth[moves])[:, :3].max() < 0.02


def test_a_fit_of_some_disks_leaves_the_others_in_the_model_image(rng):
    disks = grid(rng)
    image = render_disks(disks, 1.5, (264, 264))
    some = np.arange(len(disks)) < 30  # so many are sooner cleared with the image than erased one by one
    problem = FitProblem(image, Noise(1.0), ContrastPrior(100.0, 10.0))
    start = ModelImage(image.copy(), np.ones(30, np.bool_), shared=True)
    found = fit_disks(problem, disks[some], blur=1.5, control=FitControl(free_blur=False), start=start)
    # rounding of the disks that were erased and drawn again
    assert found.model == pytest.approx(image, abs=1e-2)


def test_no_disk_is_a_result_too():
    found = fit(np.zeros((20, 20), np.float32), np.empty((0, 4)), blur=1.5)
    assert found.disks.shape == (0, 4)
    assert not found.model.any()


def test_contrast_prior_measures_the_spread_of_contrasts(rng):
    truth = grid(rng, radii=(6, 12))
    truth[:, 3] *= 1 + 0.05 * rng.standard_normal(len(truth))
    image = render_disks(truth, 1.5, (264, 264)) + rng.normal(0, 2.0, (264, 264)).astype(np.float32)
    problem = FitProblem(image, Noise(4.0), ContrastPrior(100.0, 30.0))
    found = fit_disks(problem, truth.copy(), blur=1.5, control=FitControl())
    prior = contrast_prior(found, problem, inflation=np.ones(len(truth)))
    # 36 contrasts give their spread to 1/sqrt(72) = 12 %, three times that
    assert prior.std == pytest.approx(np.std(truth[:, 3]), rel=0.36)
    assert prior.mean == pytest.approx(truth[:, 3].mean(), abs=3 * prior.std / 6)


def test_inverse_of_a_small_matrix(rng):
    for _ in range(5):
        root = rng.standard_normal((4, 6))
        matrix = root @ root.T
        out = np.empty((4, 4))
        invert_4x4(matrix, out)
        assert np.allclose(out @ matrix, np.eye(4), atol=1e-9 * np.linalg.cond(matrix))


def test_white_noise_needs_no_inflation_and_smooth_noise_does(rng):
    white = rng.normal(0, 2.0, (1200, 1200)).astype(np.float32)
    background = np.ones((150, 150), bool)
    radius = np.array([1.5, 5.0, 20.0])
    found = measure_correlation(white, 0.0 * white, background, noise=2.0)
    none = found.inflation(radius, 1.5, noise=Noise(4.0), gain=1.0, rim=True)
    # 2 x 2.4e5 products a lag scatter by 4/690; over the 2 pi d pixels at distance d <= 10, weighted by the
    # rim's
    # autocorrelation (0.3 and less), that is sqrt(sum (2 pi d 0.3)^2) x 0.0014 = 6 %
    assert np.all(none < 1.2)
    # noise that is one value over 3 x 3 pixels counts nine times where the rim is wide, less across it
    smooth = NoiseCorrelation(np.r_[4.0, 4.0, 4.0, np.zeros(8)])
    assert np.all(smooth.inflation(radius, 1.5, noise=Noise(4.0), gain=1.0, rim=True) > 4.0)


def test_overlap_rule():
    # depth/(2 a_small): touching 0, overlapping by 0.2, by 0.5, and inside
    disks = np.array([[0, 0, 10, 1], [15, 0, 5, 1], [0, 13, 5, 1], [0, -10, 5, 1], [100, 0, 3, 1]], float)
    assert list(overlapping(disks, 0.35)) == [False, False, False, True, False]


def test_of_a_faint_disk_and_one_in_it_not_both_are_dropped(rng):
    """A contact that is brighter inside is covered by a bright disk in a faint one: one of them stays."""
    disks = np.array([[30.0, 30.0, 12.0, 90.0], [30.0, 30.0, 16.0, 20.0]])
    image = render_disks(disks, 1.5, (60, 60)) + rng.normal(0, 1.0, (60, 60)).astype(np.float32)
    problem = FitProblem(image, Noise(1.0), ContrastPrior(100.0, 60.0))
    found = fit_disks(problem, disks, blur=1.5, control=FitControl(free_blur=False))
    assert find_insignificant(found, problem, final=True).tolist() == [False, True]


def test_halo_is_found_and_taken_out():
    truth = pd_disks([(60, 60, 20), (150, 70, 12), (90, 150, 15), (200, 180, 25)])
    core = Optics(shape=(240, 260), texture=0, dust=0, camera=(1e5, 10.0), vignetting=0, full_scale=65535)
    clean, _ = (image.astype(np.float32) for image in render(truth, core, np.random.default_rng(0)))
    hazy = render(truth, Optics(**{**core.__dict__, "halo": 0.2}), np.random.default_rng(0))[0].astype(
        np.float32
    )
    model = clean - 80.0
    halo = estimate_halo(hazy - 80.0, model, contrast=100.0, contacts=12)
    # pixels beyond the core tell the fraction to a per cent or two of itself
    assert halo.sigma_px == 8.0
    assert halo.fraction == pytest.approx(0.2, abs=0.01)
    assert estimate_halo(model, model, contrast=100.0, contacts=12) is None
    # the scatter of two contacts says nothing about that of more
    assert estimate_halo(hazy - 80.0, model, contrast=100.0, contacts=2) is None
    left = subtract_halo(hazy - 80.0, model, halo) - model
    # 5 % for the fraction, and half a step, 10 %, for the width
    assert np.sqrt(np.mean(left**2)) < 0.15 * np.sqrt(np.mean((hazy - clean) ** 2))


def pd_disks(rows):
    return pd.DataFrame(rows, columns=["x_px", "y_px", "radius_px"], dtype=float).assign(kind=0)


SEPARATION = {
    "gap of half a pixel": [(50, 50, 8), (66.5, 50, 8)],
    "touching": [(50, 50, 8), (62, 61, 8.28)],
    "overlapping by a fifth": [(50, 50, 9), (64.4, 50, 9)],
    "small on large": [(50, 50, 14), (66, 50, 2)],
    "three in a row": [(40, 50, 7), (54.2, 50, 7), (68.5, 52, 7)],
    "ring of four": [(45, 45, 8), (61.5, 45, 8), (45, 61.5, 8), (61.5, 61.5, 8)],
    "cluster of five": [(50, 50, 8), (63, 50, 4.5), (50, 63, 4.5), (37, 50, 4.5), (50, 37, 4.5)],
}


@pytest.mark.parametrize("name", SEPARATION)
def test_touching_disks_are_told_apart(name):
    # five others far away show contrast and blur
    others = [(130, 30, 10), (170, 40, 6), (140, 90, 8), (180, 95, 12), (30, 110, 6)]
    truth = pd_disks([*SEPARATION[name], *others])
    frame, reference = render(truth, Optics(shape=(140, 220), dust=0), np.random.default_rng(4))
    found = measure_image(frame, reference).disks
    assert len(found) == len(truth)
    pairs = match(truth, found)
    assert len(pairs) == len(truth)
    flags = found["flags"].to_numpy()[pairs[:, 1]][np.argsort(pairs[:, 0])]
    assert all(flag & Flag.MERGED for flag in flags[: len(SEPARATION[name])])
    assert not any(flag & Flag.MERGED for flag in flags[len(SEPARATION[name]) :])


def test_a_ragged_contact_is_one_contact(rng):
    y, x = np.mgrid[0:140, 0:220]
    angle = np.arctan2(y - 60, x - 60)
    # milling leaves lobes of 8 % of the radius
    ragged = np.hypot(x - 60, y - 60) < 18 * (1 + 0.08 * np.cos(5 * angle + 1) + 0.05 * np.cos(3 * angle))
    shape = cv2.GaussianBlur(ragged.astype(np.float32), (0, 0), 1.4)
    truth = pd_disks([(150, 40, 10), (180, 100, 8), (130, 105, 6)])
    optics = Optics(shape=(140, 220), dust=0, texture=0, vignetting=0)
    frame, reference = render(truth, optics, rng)
    frame = np.clip(np.rint(frame + 100 * shape), 0, 255).astype(np.uint8)
    found = measure_image(frame, reference, shape="disk").disks
    assert len(found) == 4
    lobed = found.loc[np.hypot(found.x_px - 60, found.y_px - 60).idxmin()]
    assert int(lobed["flags"]) & Flag.POOR_FIT
