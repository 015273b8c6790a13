"""The plan: what it drops adds up to less than the tolerance, orders hold, what is off is not run."""

import itertools
import json

import numpy as np
import pandas as pd
import pytest
from effect_scenes import hexagon, mechanical_scene, pattern

import contactimg
from contactimg import InputError
from contactimg.cli import main
from contactimg.effects import solve_without
from contactimg.effects.output_change import EffectEstimate
from contactimg.effects.plan import SAFETY_FACTOR, decide, make_plan
from contactimg.files import read_scene, write_scene
from contactimg.mechanics import layer, sphere
from contactimg.models import contact_solver, interacting
from contactimg.models.adhesive import TouchingCaps
from contactimg.models.asperity_laws import SphereLaw
from contactimg.models.coupling import DenseCoupling
from contactimg.models.full_coupling import FieldCorrection
from contactimg.prediction import predict_contacts
from contactimg.scene import Effects, Tolerance, scene_from_dict
from contactimg.tables import EFFECTS

ONE_PERCENT = Tolerance(relative=0.01)


def on(decisions):
    return {decision.effect for decision in decisions if decision.on}


# the budget


def test_what_is_dropped_stays_below_the_tolerance_as_a_sum():
    rng = np.random.default_rng(5)
    names = [n for n in Effects().switches() if n not in {"full_coupling", "layer", "adhesion"}]
    for _ in range(200):
        estimates = [EffectEstimate(n, 10 ** rng.uniform(-5, -1), "") for n in names]
        decisions, _ = decide(estimates, Effects(), ONE_PERCENT)
        dropped = [d.change for d in decisions if not d.on]
        assert sum(dropped) < 0.01
        # as much as fits is dropped: no effect that is on fits too
        assert all(SAFETY_FACTOR * (sum(dropped) + d.change) >= 0.01 for d in decisions if d.on)


def test_three_that_fit_one_by_one_do_not_fit_together():
    estimates = [EffectEstimate(name, 0.004, "") for name in ("layer", "blur", "dust")]
    decisions, _ = decide(estimates, Effects(), ONE_PERCENT)
    # 1.25 * 0.004 = 0.005 fits, 0.010 meets the tolerance exactly: on; ties by name
    assert on(decisions) == {"dust", "layer"}


def test_the_order_of_the_estimates_does_not_matter():
    estimates = [EffectEstimate(n, 0.004, "") for n in ("layer", "blur", "dust", "film")]
    found = {
        frozenset(on(decide(order, Effects(), ONE_PERCENT)[0])) for order in itertools.permutations(estimates)
    }
    assert len(found) == 1


@pytest.mark.parametrize("change", [0.008, np.nextafter(0.008, 0)])
def test_an_estimate_exactly_at_the_tolerance_is_kept(change):
    # 1.25 * 0.008 is 0.01 exactly, in floating point too
    decisions, _ = decide([EffectEstimate("layer", change, "")], Effects(), ONE_PERCENT)
    assert decisions[0].on == (change == 0.008)


def test_the_smallest_are_dropped_first_and_of_equal_ones_the_first_by_name():
    estimates = [EffectEstimate("layer", 0.004, ""), EffectEstimate("dust", 0.006, "")]
    assert on(decide(estimates, Effects(), ONE_PERCENT)[0]) == {"dust"}
    equal = [EffectEstimate("layer", 0.005, ""), EffectEstimate("dust", 0.005, "")]
    assert on(decide(equal, Effects(), ONE_PERCENT)[0]) == {"layer"}


@pytest.mark.parametrize("change", [np.nan, np.inf, -1e-9])
def test_an_estimate_is_a_number(change):
    with pytest.raises(InputError, match="change of the effect layer must be finite and not negative"):
        EffectEstimate("layer", change, "")


# orders


def test_orders_are_obeyed_and_do_not_count():
    estimates = [
        EffectEstimate("layer", 0.5, "thin"),
        EffectEstimate("dust", 1e-9, ""),
        EffectEstimate("film", 0.007, ""),
    ]
    decisions, messages = decide(estimates, Effects(layer="off", dust="on"), ONE_PERCENT)
    assert on(decisions) == {"dust"}
    assert len(messages) == 1
    assert "layer is switched off although that changes the requested output by about 0.5" in messages[0]
    assert [d.switch for d in decisions] == ["off", "on", "auto"]


def test_what_acts_through_coupling_goes_with_it():
    full, thin = EffectEstimate("full_coupling", 0.006, ""), EffectEstimate("layer", 0.3, "thin")
    # coupling's change includes that of full coupling
    decisions, messages = decide([EffectEstimate("coupling", 0.005, ""), full], Effects(), ONE_PERCENT)
    assert on(decisions) == set()
    assert [d.change for d in decisions] == [0.005, 0.0]
    assert "acts through coupling, which is left out" in decisions[1].reason
    assert not messages
    matters = [EffectEstimate("coupling", 0.5, ""), full, thin]
    assert on(decide(matters, Effects(), ONE_PERCENT)[0]) == {"coupling", "layer"}
    slight = [EffectEstimate("coupling", 1e-6, ""), full]
    assert on(decide(slight, Effects(full_coupling="on"), ONE_PERCENT)[0]) == {"coupling", "full_coupling"}
    assert on(decide([*slight, thin], Effects(), ONE_PERCENT)[0]) == {"coupling", "layer"}
    decisions, messages = decide(matters, Effects(coupling="off", layer="on"), ONE_PERCENT)
    assert on(decisions) == set()
    assert "layer is switched on but acts through coupling, which is left out" in messages
    assert any("coupling is switched off although" in sentence for sentence in messages)


# the plan and the scene


def test_an_effect_without_a_solution_is_left_out_and_named(monkeypatch):
    scene, table, load = mechanical_scene("close pair")
    assert make_plan(scene, table, load=load).is_on("full_coupling")
    solve = solve_without.solve_scene

    def no_full_coupling(*args, coupling, **options):
        if coupling == "full":
            raise contactimg.ConvergenceError("full coupling did not converge")
        return solve(*args, coupling=coupling, **options)

    monkeypatch.setattr(solve_without, "solve_scene", no_full_coupling)
    plan = make_plan(scene, table, load=load)
    assert not plan.is_on("full_coupling")
    sentence = "full_coupling is not compared: no solution to compare with: full coupling did not converge"
    assert sentence in plan.limits


def test_apply_makes_every_mechanical_switch_explicit_and_plans_the_same_again():
    scene, table, load = mechanical_scene("layer of 1 mm")
    plan = make_plan(scene, table, load=load)
    explicit = plan.apply(scene)
    for name in solve_without.MECHANICAL_EFFECTS:
        assert getattr(explicit.effects, name) == ("on" if plan.is_on(name) else "off")
    again = make_plan(explicit, table, load=load)
    assert on(again.decisions) == on(plan.decisions)
    assert explicit.folder == scene.folder
    assert scene.effects == Effects()
    assert not plan.is_on("no such effect")


def test_table_and_record():
    scene, table, load = mechanical_scene("SA+ 0.02 N")
    plan = make_plan(scene, table, load=load)
    assert list(plan.table()) == list(EFFECTS.columns)
    assert set(plan.table()["decision"]) <= {"on", "off", "not modelled"}
    assert (plan.table()["load_N"] == load).all()
    assert set(plan.record[0]) == {"effect", "change", "decision", "reason"}
    json.dumps(plan.record)


# what is off is not run


@pytest.fixture
def counted(monkeypatch):
    """How often the code of each effect runs."""
    counts = dict.fromkeys(("matrix", "product", "full", "sphere", "layer", "adhesion"), 0)

    def count(owner, name, key):
        original = getattr(owner, name)

        def counting(*args, **kwargs):
            counts[key] += 1
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, counting)

    count(DenseCoupling, "__init__", "matrix")
    count(DenseCoupling, "displacement", "product")
    count(FieldCorrection, "apply", "full")
    count(SphereLaw, "respond", "sphere")
    count(sphere, "scaled_indentation", "sphere")  # on a layer, and with adhesion
    count(layer, "deficit_table", "layer")
    count(TouchingCaps, "slopes", "adhesion")
    assert contact_solver.FieldCorrection is FieldCorrection
    assert interacting.asperity_law("sphere", aspect=1.0) == SphereLaw(1.0)
    return counts


EVERYTHING = {"matrix", "product", "full", "sphere", "layer"}


@pytest.mark.parametrize(
    ("name", "relative", "run"),
    [
        ("SA+ tiny load", 0.01, set()),
        ("stiff and dilute", 0.01, set()),
        ("SA- 5 mN", 0.01, {"sphere"}),
        ("SA+ 0.5 N", 0.05, {"matrix", "product"}),
        ("SA+ 0.5 N", 0.01, {"matrix", "product", "sphere"}),
        ("layer of 1 mm", 0.032, {"matrix", "product", "layer"}),
        ("SA+ large load", 0.0015, {"matrix", "product", "sphere", "full"}),
        ("layer of 1 mm", 1e-4, EVERYTHING),
        ("very adhesive, light", 0.05, {"adhesion"}),
        ("RA+ adhesive", 0.01, {"matrix", "product", "sphere", "adhesion"}),
        # contacts that several effects together let form count for each of them, the layer too
        ("RA+ adhesive", 0.002, {"matrix", "product", "sphere", "adhesion", "layer"}),
    ],
)
def test_the_code_of_an_effect_that_is_off_is_not_run(counted, name, relative, run):
    scene, table, load = mechanical_scene(name, relative=relative)
    plan = make_plan(scene, table, load=load)
    counted.update(dict.fromkeys(counted, 0))
    predict_contacts(plan.apply(scene), table, load=load)
    assert {key for key, count in counted.items() if count} == run


# plan_effects and the commands


@pytest.fixture
def folder(tmp_path):
    """A scene with its table."""
    pattern("SA", side=4e-3).to_csv(tmp_path / "asperities.csv", index=False)
    scene = {
        "indenter": {"radius_m": 0.1288},
        "elastic": {"young_modulus_Pa": 3e6, "thickness_m": 0.015},
        "asperities": {"file": "asperities.csv"},
        "tolerance": {"output": "force", "relative": 0.02},
    }
    write_scene(scene, tmp_path / "scene.toml")
    return tmp_path


def test_the_load_is_the_largest_that_the_scene_states(folder):
    scene = read_scene(folder)
    with pytest.raises(InputError, match="states no load; give one"):
        contactimg.plan_effects(scene)
    assert contactimg.plan_effects(scene, load=0.02).load == 0.02
    pd.DataFrame({"frame": ["a.tif", "b.tif"], "load_N": [0.03, 0.01]}).to_csv(
        folder / "loads.csv", index=False
    )
    assert contactimg.plan_effects(scene).load == 0.03
    assert contactimg.plan_effects(scene).output == "force"


def test_effects_prints_the_numbers_and_writes_them(folder, capsys):
    out = folder / "plan"
    assert main(["effects", str(folder), "--load-N", "0.1", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "coupling" in printed
    assert "sphere_profile" in printed
    table = pd.read_csv(out / "effects.csv")
    assert list(table) == list(EFFECTS.columns)
    assert dict(zip(table["effect"], table["decision"], strict=True))["coupling"] == "on"
    assert (table["tolerance"] == 0.02).all()
    assert json.loads((out / "provenance.json").read_text())["command"].startswith("contactimg effects")
    loose = ["effects", str(folder), "--load-N", "1e-6", "--tolerance", "0.5", "--output", "area"]
    assert main([*loose, "-o", str(out), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    decisions = pd.read_csv(out / "effects.csv").set_index("effect")["decision"]
    assert (decisions.drop(["finite_strain", "cap_slope"]) == "off").all()
    assert (decisions[["finite_strain", "cap_slope"]] == "not modelled").all()


@pytest.mark.parametrize("output", ["all", "profile"])
def test_effects_takes_every_output_and_leaves_all_to_the_plan(folder, capsys, output):
    scene = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(scene + '\n[effects]\ncoupling = "off"\n')
    arguments = ["effects", str(folder), "--load-N", "0.1", "--output", output]
    assert main(arguments) == 0
    ordered = capsys.readouterr().out
    assert "off (scene)" in ordered
    assert "coupling is switched off although" in ordered
    assert main([*arguments, "--auto"]) == 0
    planned = capsys.readouterr().out
    assert f"{output} to 2 %" in planned
    assert "(scene)" not in planned
    assert "not modelled" in planned


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ([], "states no load"),
        (["--load-N", "0.1", "--tolerance", "0"], "relative must be greater than 0"),
        (["--load-N", "-1"], "positive unless the contacts adhere"),
    ],
)
def test_effects_that_cannot_be_planned_are_one_sentence(folder, capsys, options, sentence):
    assert main(["effects", str(folder), *options]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_an_impossible_load_does_not_lose_the_others(folder, capsys):
    out = folder / "predicted"
    arguments = [
        "predict",
        str(folder),
        "--load-N",
        "0.05",
        "--load-N",
        "50",
        "--load-N",
        "1e-5",
        "-o",
        str(out),
    ]
    assert main(arguments) == 1
    assert "the planes touch" in capsys.readouterr().out.replace("\n", " ")
    frames = pd.read_csv(out / "frames.csv")
    assert list(frames["status"]) == ["ok", "failed", "ok"]
    assert "the planes touch" in frames["message"][1]
    plans = json.loads((out / "provenance.json").read_text())["plans"]
    assert set(plans) == {"load_0.05N", "load_1e-05N"}
    decisions = {name: {e["effect"]: e["decision"] for e in plan} for name, plan in plans.items()}
    assert decisions["load_0.05N"]["coupling"] == "on"
    assert decisions["load_1e-05N"]["coupling"] == "off"
    assert main(["predict", str(folder), "--load-N", "50", "-o", str(folder / "none")]) == 2
    assert not (folder / "none").exists()


def test_statistical_models_know_no_level_of_coupling(folder, capsys):
    arguments = ["predict", str(folder), "--load-N", "0.05", "--model", "gt", "-o", str(folder / "gt")]
    assert main([*arguments, "--coupling", "full"]) == 2
    assert 'model "gt" has no levels of coupling' in capsys.readouterr().err


def test_statistical_models_refuse_effects_that_they_do_not_know(folder, capsys):
    scene = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(scene + '\n[effects]\nsphere_profile = "on"\n')
    assert main(["predict", str(folder), "--load-N", "0.05", "--model", "gt", "-o", str(folder / "gt")]) == 2
    assert 'model "gt" cannot represent sphere_profile' in capsys.readouterr().err


@pytest.mark.parametrize("load", ["1e-300", "1e-30"])
def test_the_smallest_loads_are_planned(folder, load):
    scene = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(scene.replace("[elastic]", "[elastic]\nwork_of_adhesion_J_m2 = 0.05"))
    out = folder / "least"
    assert main(["predict", str(folder), "--load-N", load, "-o", str(out), "--quiet"]) in (0, 2)


@pytest.mark.parametrize(
    ("coupling", "level"), [("none", "none"), ("asymptotic", "asymptotic"), ("full", "full")]
)
def test_a_level_given_by_option_is_an_order(folder, coupling, level):
    from contactimg.pipeline.predict import predict_loads

    scene = read_scene(folder)
    options = {"model": "interacting", "annulus": 2.5e-4}
    prediction = predict_loads(scene, [0.05], coupling=coupling, **options)[0]
    assert prediction.plan.coupling == level
    message = prediction.frames["message"][0]
    assert ("coupling is switched off although" in message) == (coupling == "none")


def test_pairs_and_lattices_take_full_coupling_where_it_matters():
    scene = scene_from_dict(
        {
            "indenter": {"radius_m": 1e6},
            "elastic": {"young_modulus_Pa": 3e6},
            "tolerance": {"output": "area"},
        }
    )
    assert make_plan(scene, hexagon(7e-5), load=4e-3).coupling == "full"
    assert make_plan(scene, hexagon(1e-3), load=4e-3).coupling == "none"
