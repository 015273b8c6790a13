"""What is common to the compiled functions."""

import importlib
import pkgutil

import numpy as np
from numba.core.registry import CPUDispatcher

import contactimg.imaging
from contactimg.imaging.pixels.masks import for_kernel

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


def test_a_part_of_a_mask_is_handed_over_like_a_whole_one():
    """For another layout in memory all that takes masks would be compiled once more."""
    part = np.ones((4, 6), np.uint8)[:, 1:5]
    assert for_kernel(part).flags.c_contiguous
    assert for_kernel(part, part).flags.c_contiguous
