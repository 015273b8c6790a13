"""What is common to the compiled functions."""

import importlib
import pkgutil

from numba.core.registry import CPUDispatcher

import contactimg.imaging

ROOM = contactimg.imaging
MODULES = [module.name for module in pkgutil.walk_packages(ROOM.__path__, f"{ROOM.__name__}.")]


def test_sums_in_any_order_are_inlined():
    """A sum that may be reordered is compiled again with each caller, in another order: unless it is inlined,
    a process that compiles adds in another order than one that loads what was compiled."""
    functions = {
        f"{name}.{key}": function
        for name in MODULES
        for key, function in vars(importlib.import_module(name)).items()
        if isinstance(function, CPUDispatcher) and function.targetoptions.get("fastmath")
    }
    assert functions
    assert [name for name, one in functions.items() if not one.targetoptions.get("forceinline")] == []
