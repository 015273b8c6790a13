"""Knobs, fronts, sentences, averages, figures."""

import math
import time

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contactimg.errors import ModelRangeError
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.greenwood_williamson import ring_weights, solve_greenwood_williamson
from contactimg.models.height_distributions import SampleHeights, UniformHeights
from contactimg.models.interacting import solve_interacting
from contactimg.plots.tradeoff import plot_knob, plot_tradeoff
from contactimg.surfaces import generate_asperities
from contactimg.tables import TRADEOFF
from contactimg.tradeoff.knobs import Average, average_contacts, average_rings
from contactimg.tradeoff.measure import (
    Knob,
    Setting,
    error_text,
    knob_sentence,
    mark_front,
    measure_knob,
    time_text,
)

positive = st.floats(1e-6, 1e3)


@given(st.lists(st.tuples(positive, positive), min_size=1, max_size=12))
def test_the_front_holds_exactly_what_nothing_beats(points):
    errors, times = zip(*points, strict=True)
    front = mark_front(errors, times)
    assert any(front)
    for k, (error, seconds) in enumerate(points):
        beaten = any(e <= error and t <= seconds and (e, t) != (error, seconds) for e, t in points)
        if front[k]:
            assert not beaten
        else:
            # beaten, or one of several equal ones
            assert beaten or points.count((error, seconds)) > 1


def busy(seconds):
    def run():
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            pass
        return seconds

    return run


def fail():
    raise ModelRangeError("beyond the model")


SETTINGS = (
    Setting("quick", busy(0.002), lambda answer: 10 * answer, "the truth"),
    Setting("slow", busy(0.01), lambda _: 1e-4, "the truth"),
    Setting("broken", fail, lambda _: 0.0, "the truth"),
)


def measured():
    return measure_knob(Knob("model", "test", "area", 0.1, SETTINGS), seconds=0.1).set_index("setting")


def test_a_knob_gives_a_row_a_setting_with_error_and_time():
    table = measured()
    assert table.loc["quick", "error"] == pytest.approx(0.02)
    # busy loops end no sooner than asked
    assert table.loc["quick", "time_s"] >= 0.002
    assert table.loc["slow", "time_s"] >= 0.01
    assert table.loc["quick", "time_ratio"] == 1
    assert table.loc["slow", "time_ratio"] == pytest.approx(
        table.loc["slow", "time_s"] / table.loc["quick", "time_s"]
    )
    assert table.loc[["quick", "slow"], "pareto"].tolist() == [1, 1]
    assert set(table["load_N"]) == {0.1}
    assert (table["reference"] != "").all()


def test_a_setting_that_fails_is_a_row_with_its_reason():
    row = measured().loc["broken"]
    assert math.isnan(row["error"])
    assert math.isnan(row["time_s"])
    assert row["message"] == "beyond the model"
    assert row["pareto"] is pd.NA


def test_repetitions_stop_with_their_time():
    calls = []
    settings = (Setting("one", lambda: calls.append(busy(0.02)()), lambda _: 0.0, "r"),)
    measure_knob(Knob("k", "k", "area", math.nan, settings), seconds=0.05)
    # the first run, then as many as fit into 0.05 s of 0.02 s each or longer: two at most
    assert 2 <= len(calls) <= 3


def front_table(*rows):
    names, errors, times = zip(*rows, strict=True)
    return pd.DataFrame({"setting": names, "error": errors, "time_s": times, "pareto": 1, "output": "area"})


def test_the_sentence_names_the_cheapest_setting_that_serves():
    table = front_table(("none", 0.2, 1e-3), ("point", 2e-3, 0.02), ("full", 1e-5, 0.2))
    sentence = knob_sentence("model", table, relative=0.01)
    assert sentence == (
        "model: for 1 % on A take point (0.2 %, 20 ms); 0.1 % needs full (0.001 %, 200 ms), 10 times the time"
    )


def test_the_sentence_says_when_nothing_serves():
    table = front_table(("none", 0.2, 1e-3))
    assert "no setting serves; the best is none (20 %, 1 ms)" in knob_sentence("m", table, relative=0.01)


def test_the_sentence_says_when_a_tenth_is_not_to_be_had():
    table = front_table(("one", 5e-3, 1e-3), ("many", 2e-3, 1.0))
    sentence = knob_sentence("m", table, relative=0.01)
    assert sentence.endswith("no setting reaches 0.1 %, at best many (0.2 %, 1 s)")


def test_the_tenth_is_that_of_what_was_reached():
    # the cheapest is already a hundred times better than asked: a tenth of its own error counts
    table = front_table(("a", 1e-4, 1e-3), ("b", 1e-5, 1.01e-3))
    sentence = knob_sentence("m", table, relative=0.01)
    assert sentence.endswith("0.001 % needs b (0.001 %, 1 ms), at no extra time")


def test_numbers_for_a_person():
    assert [time_text(t) for t in (2.34e-6, 1e-3, 0.0321, 0.9999, 75.0)] == [
        "2.3 us", "1 ms", "32 ms", "1 s", "1.2 min",
    ]  # fmt: skip
    assert [error_text(e) for e in (0.0, 3.14e-9, 0.01, 0.123)] == ["no error", "3e-09", "1 %", "12 %"]


# --- averages -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pattern():
    table = generate_asperities("SA", side=4e-3, rng=np.random.default_rng(4))
    where = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "load": 0.05, "apex": (2e-3, 2e-3)}
    return solve_interacting(table, coupling="none", **where)


def test_annuli_share_the_load(pattern):
    edges = np.linspace(0.0, 5e-4, 5)  # contacts beyond count in the last
    average = average_contacts(pattern, centre=(2e-3, 2e-3), edges=edges)
    assert average.loads.sum() == pytest.approx(0.05, rel=1e-12)
    assert average.area == pattern.area
    near = np.hypot(pattern.x - 2e-3, pattern.y - 2e-3) < edges[1]
    assert average.loads[0] == pytest.approx(pattern.force[near].sum(), rel=1e-12)


def test_rings_give_the_loads_of_annuli():
    law = UniformHeights(30e-6, 60e-6)
    where = {"density": 18.45e6, "radius": 1e-4, "indenter_radius": 0.1288, "contact_modulus": 4e6}
    rings = solve_greenwood_williamson(law, load=0.5, rings=2000, **where)
    edges = np.array([0.0, 0.4, 1.0]) * rings.r[-1]
    loads = average_rings(rings, edges=edges).loads
    # D = 30.94 um stays within the width s, where p(x) = (2/5) K sqrt(R) eta0 x^(5/2)/s with
    # x = D - r^2/(2 Rl): the load beyond r goes as x^(7/2)
    outside = (1 - (edges[1] / rings.r[-1]) ** 2) ** 3.5
    assert rings.depth[0] > law.width  # just above: the closed form is off by (x - s)^(5/2) at the very axis
    # 2000 rings, second order: 1e-6; the axis: ((30.94 - 30)/30.94)^(7/2) = 5e-6
    assert loads.sum() == pytest.approx(0.5, rel=2e-5)
    assert loads[1] / loads.sum() == pytest.approx(outside, rel=3e-5)


@pytest.mark.parametrize("solve", [solve_greenwood_williamson, solve_greenwood_tripp])
@pytest.mark.parametrize("heights", [UniformHeights(30e-6, 60e-6), SampleHeights(1e-7 * np.arange(300, 600))])
def test_rings_have_a_mean_radius_where_nothing_touches_at_their_end(solve, heights):
    where = {"density": 18.45e6, "radius": 1e-4, "indenter_radius": 0.1288, "contact_modulus": 4e6}
    rings = solve(heights, load=0.2, **where)
    assert rings.density[-1] <= 1e-6 * rings.density[0]
    average = average_rings(rings, edges=np.linspace(0.0, 2e-3, 9))
    # the mean over all contacts by the rings' own rule; both are of second order in their width
    weights = ring_weights(rings.r) * rings.density
    expected = float(weights @ np.nan_to_num(rings.mean_radius) / weights.sum())
    assert average.mean_radius == pytest.approx(expected, rel=2e-3)
    other = Average(average.area, average.loads, 2 * average.mean_radius)
    assert average.change("all", other) == pytest.approx(0.5)


def test_changes_of_averages():
    one = Average(2.0, np.array([1.0, 3.0]), 10.0)
    other = Average(2.2, np.array([1.5, 2.5]), 9.0)
    changes = [other.change(name, one) for name in ("area", "force", "radius")]
    assert changes == pytest.approx([0.1, 0.25, 0.1])


# --- figures --------------------------------------------------------------------------------------------


def texts(ax):
    legend = ax.get_legend()
    return set() if legend is None else {text.get_text().replace("\n", " ") for text in legend.get_texts()}


def test_the_figure_shows_every_setting_that_has_numbers():
    ax = plot_knob(measured().reset_index(), relative=0.01)
    assert texts(ax) == {"quick", "slow"}
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    drawn = {(x, y) for line in ax.lines[1:3] for x, y in zip(*line.get_data(), strict=True)}
    assert len(drawn) == 2


def test_an_error_of_zero_is_drawn_below_the_others():
    table = TRADEOFF.conform(
        pd.DataFrame(
            {
                "knob": "image",
                "setting": ["a", "b"],
                "error": [1e-3, 0.0],
                "time_s": [1.0, 2.0],
                "pareto": [1, 1],
                "output": "area",
            }
        )
    )
    ax = plot_knob(table, relative=0.01)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), [1e-3, 1e-4])


def test_one_panel_a_knob_and_a_legend():
    table = measured().reset_index()
    two = pd.concat([table, table.assign(knob="image")], ignore_index=True)
    figure = plot_tradeoff(two, relative=0.01).get_figure()
    titles = [ax.get_title(loc="left") for ax in figure.axes if ax.axison]
    kinds = [title.split("\n")[0] for title in titles]
    assert kinds == ["contact model", "measurement of a frame"]
    assert len(figure.legends) == 1


def test_the_recommended_setting_is_marked_with_its_sentence():
    table = front_table(("none", 0.2, 1e-3), ("point", 2e-3, 0.02), ("full", 1e-5, 0.2))
    ax = plot_knob(TRADEOFF.conform(table.assign(knob="model")), relative=0.01)
    marked = [line.get_xydata() for line in ax.lines if line.get_label() == "recommended"]
    np.testing.assert_allclose(marked, [[[0.02, 2e-3]]])
    assert ax.get_title(loc="left") == "contact model\nfor 1 % on A take point (0.2 %, 20 ms)"
    nothing = plot_knob(TRADEOFF.conform(table.assign(knob="model")), relative=1e-9)
    assert "recommended" not in {line.get_label() for line in nothing.lines}
    assert "no setting serves" in nothing.get_title(loc="left")


def test_a_knob_without_numbers_gives_an_empty_panel():
    table = measured().reset_index().query("setting == 'broken'")
    assert texts(plot_knob(table, relative=0.01)) == set()
