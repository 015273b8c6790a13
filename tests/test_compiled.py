"""What is common to the compiled functions."""

import importlib
import pkgutil

import pytest
from numba.core.registry import CPUDispatcher

import contactimg.imaging

MODULES = [f"contactimg.imaging.{module.name}" for module in pkgutil.iter_modules(contactimg.imaging.__path__)]


@pytest.mark.parametrize("name", MODULES)
def test_sums_in_any_order_are_inlined(name):
    """A sum that may be reordered is compiled again within each caller, in another order: unless it is inlined,
    a process that compiled its callers adds in another order than one that loads them, by the last bits."""
    module = importlib.import_module(name)
    for function in vars(module).values():
        if isinstance(function, CPUDispatcher) and function.targetoptions.get("fastmath"):
            assert function.targetoptions.get("forceinline"), f"{name}.{function.__name__}"
