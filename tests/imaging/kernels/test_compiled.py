"""What is common to the compiled functions."""

import importlib
import pkgutil

import pytest
from numba.core.registry import CPUDispatcher

import contactimg.imaging

ROOM = contactimg.imaging
MODULES = [module.name for module in pkgutil.walk_packages(ROOM.__path__, f"{ROOM.__name__}.")]


@pytest.mark.parametrize("name", MODULES)
def test_sums_in_any_order_are_inlined(name):
    """A sum that may be reordered is compiled again with each caller, in another order: unless it is inlined,
    a process that compiles adds in another order than one that loads what was compiled."""
    module = importlib.import_module(name)
    for function in vars(module).values():
        if isinstance(function, CPUDispatcher) and function.targetoptions.get("fastmath"):
            assert function.targetoptions.get("forceinline"), f"{name}.{function.__name__}"
