"""Public functions refuse an argument of another class with one sentence."""

import inspect
import pickle

import numpy as np
import pytest

import contactimg
from contactimg.errors import MADE_BY, InputError

FUNCTIONS = {name: getattr(contactimg, name) for name in contactimg.__all__}
ARGUMENTS = [
    (function, name, kind)
    for function in filter(inspect.isfunction, FUNCTIONS.values())
    for name, parameter in inspect.signature(function).parameters.items()
    for kind in MADE_BY
    if getattr(parameter.annotation, "__name__", "") == kind
]


@pytest.mark.parametrize(
    ("function", "name", "kind"), ARGUMENTS, ids=[f"{one.__name__} {name}" for one, name, _ in ARGUMENTS]
)
def test_an_argument_of_another_class_is_named(function, name, kind):
    for value in (None, 3, "folder"):
        said = f"^{function.__name__}: {name} must be a {kind} \\(.*{value!r}$"
        with pytest.raises(InputError, match=said):
            function(**{name: value})


def test_scenes_generators_and_tables_are_among_them():
    assert {kind for _, _, kind in ARGUMENTS} == set(MADE_BY)


def test_arguments_that_may_be_missing_or_are_right_go_through():
    with pytest.raises(InputError, match="asperities must be a DataFrame"):
        contactimg.find_touching_load(contactimg.scene_from_dict({}), asperities="a.csv")
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        contactimg.plan_effects()
    with pytest.raises(InputError, match="the same annuli"):
        contactimg.average_profile([], frame="a", model="coupled")
    table = contactimg.generate_asperities("SA", side=1e-3, coverage=0.1, rng=np.random.default_rng(1))
    assert len(contactimg.composite_apexes(table, indenter_radius=0.1)) == len(table)


def test_public_functions_go_to_other_processes():
    assert b"measure_frame" in pickle.dumps(contactimg.measure_frame)
