"""Whether there is an air film: decided by the rims where they can tell, part of the uncertainty else."""

import numpy as np
import pytest
from film_frames import LED, SPHERE_M, film_frame

from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.tables import Status

FINE_PIXEL, COARSE_PIXEL = 2e-6, 6e-6


def measured(pixel_size, *, film, asked, seed=31, contrast=0.9, doubt=0.2):
    """Relative error of the sum of the areas, its stated uncertainty, and the measurement."""
    frame, reference, truth = film_frame(pixel_size, film=film, seed=seed, contrast=contrast)
    setting = FilmSetting(FilmRim(LED, SPHERE_M, pixel_size), asked, doubt)
    result = measure_image(frame, reference, polarity="bright", film=setting, linearity=0.0)
    disks, area = result.disks, float(np.sum(truth["radius_px"] ** 2))
    assert len(disks) == len(truth)
    slope = 2.0 * disks["radius_px"].to_numpy()
    shifts = disks[["contrast_shift_px", "blur_shift_px", "edge_shift_px"]].to_numpy()
    own = disks["radius_std_px"].to_numpy() ** 2 - np.sum(shifts**2, axis=1)
    std = np.sqrt(np.sum((slope @ shifts) ** 2) + np.sum(slope**2 * np.maximum(own, 0.0))) / area
    return float(np.sum(disks["radius_px"] ** 2)) / area - 1.0, std, result


@pytest.mark.parametrize("film", [True, False])
def test_rims_decide_where_they_show_the_film(film):
    error, std, result = measured(FINE_PIXEL, film=film, asked="auto", contrast=0.08)
    verdict = result.film
    assert verdict.taken is film
    assert (verdict.light > 0.5) is film
    assert abs(verdict.area_change) == pytest.approx(0.055, abs=0.02)
    assert abs(error) < 3 * std < 0.05
    assert abs(error) < 0.005
    assert result.status == Status.OK
    if film:
        assert result.optics.blur_px == pytest.approx(1.4, abs=0.05)
        assert 0 < result.optics.blur_std_px < 0.05
        assert "an air film surrounds the contacts" in result.message or verdict.doubt > 0.01


@pytest.mark.parametrize(
    ("film", "asked"),
    [(True, "off"), (False, "on")],
)
def test_what_is_set_by_hand_against_the_rims_is_said(film, asked):
    error, std, result = measured(1e-6, film=film, asked=asked)
    assert result.film.contradicted
    assert result.status == Status.FILM or "the rims say the opposite" in result.message
    assert result.status != Status.OK
    assert abs(error) > 0.05
    assert abs(error) < 3 * std


@pytest.mark.parametrize("film", [True, False])
@pytest.mark.parametrize("asked", ["auto", "off"])
def test_what_the_rims_leave_open_is_part_of_the_uncertainty(film, asked):
    # 8 % of the background: such a contrast is that of a film, and speaks against "off"
    error, std, result = measured(COARSE_PIXEL, film=film, asked=asked, contrast=0.08)
    assert 0.02 < result.film.doubt < 0.5
    assert "the rims cannot tell" in result.message
    assert result.film.taken is (asked != "off")
    assert abs(error) < 3 * std
    assert abs(result.film.area_change) == pytest.approx(0.013, abs=0.006)
    assert (result.disks["edge_shift_px"].abs() > 0).all()


@pytest.mark.parametrize("film", [True, False])
def test_a_contrast_of_another_cause_does_not_exclude_a_film(film):
    error, std, result = measured(COARSE_PIXEL, film=film, asked="auto")
    verdict = result.film
    assert not verdict.taken
    assert verdict.doubt >= 0.2
    # of two hypotheses with odds of four to one, the wrong one is off by sqrt(5) = 2.2 uncertainties at most
    assert abs(verdict.area_change) < 2.3 * std
    assert abs(error) < 3 * std
    assert 'state [effects] film = "on" or "off"' in result.message
    # all contacts share it: it is no scatter of their own
    shift = result.disks["edge_shift_px"].abs().to_numpy()
    assert (shift > 0).all()
    assert 2.0 * np.sum(shift * result.disks["radius_px"]) > 0.4 * abs(verdict.area_change) * np.sum(
        result.disks["radius_px"] ** 2
    )


@pytest.mark.parametrize(("film", "asked"), [(True, "on"), (False, "off"), (True, "off"), (False, "on")])
@pytest.mark.parametrize("pixel_size", [4e-6, COARSE_PIXEL])
def test_a_statement_that_the_rims_cannot_check_is_taken_and_its_doubt_stated(pixel_size, film, asked):
    error, std, result = measured(pixel_size, film=film, asked=asked)
    right, verdict = film is (asked == "on"), result.film
    assert verdict.taken is (asked == "on")
    assert not verdict.contradicted
    # the rims of a film that is stated to be absent look soft
    assert result.status == Status.OK or (film and not right and result.status == Status.SOFT)
    # the wrong one of two is off by sqrt(1 + ODDS) = 2.2 uncertainties at most, and by 0.5 of noise
    assert abs(error) < (1.0 if right else 2.7) * std
    # at least sqrt(0.2) of the difference, and little else
    assert std > 0.44 * abs(verdict.area_change)
    assert not right or std < 0.55 * abs(verdict.area_change)
    assert ("the rims cannot tell" in result.message) is (verdict.doubt > 0.01)


@pytest.mark.parametrize("film", [True, False])
def test_what_is_known_for_certain_widens_nothing(film):
    error, std, result = measured(COARSE_PIXEL, film=film, asked="on" if film else "off", doubt=0.0)
    assert abs(error) < 3 * std < 0.012
    assert result.film.doubt < 0.001
    assert "cannot tell" not in result.message


@pytest.mark.parametrize("film", [True, False])
def test_a_statement_that_the_rims_confirm_leaves_no_doubt(film):
    error, std, result = measured(FINE_PIXEL, film=film, asked="on" if film else "off")
    assert result.film.doubt < 0.01
    assert result.status == Status.OK
    assert abs(error) < 3 * std < 0.03


def test_a_film_that_changes_nothing_is_not_looked_for():
    frame, reference, _ = film_frame(COARSE_PIXEL, film=False, seed=31)
    narrow = FilmSetting(FilmRim(LED, 1e-9, 1e-3), "auto")
    with_question = measure_image(frame, reference, polarity="bright", film=narrow)
    assert with_question.film is None
    without = measure_image(frame, reference, polarity="bright")
    assert with_question.disks["radius_px"].tolist() == without.disks["radius_px"].tolist()
