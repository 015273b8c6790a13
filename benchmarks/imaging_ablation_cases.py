"""Special cases of the imaging, and what takes the place of each where it is switched off.

A case is switched off by replacing functions or constants of the package where they are used; the package
itself has no switch. A replaced name that does not exist, or that no condition calls, is an error.
"""

import ast
import inspect
import io
import tokenize
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pkgutil import resolve_name
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from contactimg.imaging.background.align import align_strips
from contactimg.imaging.background.align_far import FarSearch
from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.background.divide import (
    BLUR_PX,
    DARKEST_FRACTION,
    NARROW_PX,
    OUTLIER_SIGMA,
    WIDE_PX,
    _moved_gaussian,
)
from contactimg.imaging.background.divide_rows import DIRT_SIGMA
from contactimg.imaging.background.find_illumination import find_background_level
from contactimg.imaging.background.illumination import BACKGROUND_CLIP_SIGMA, Illumination, fit_illumination
from contactimg.imaging.background.no_reference import estimate_background
from contactimg.imaging.background.resample import filter_rows_and_columns, shift_kernel
from contactimg.imaging.contrast.noise import LARGEST_LAG, NoiseCorrelation
from contactimg.imaging.fit.covers import Replacement
from contactimg.imaging.fit.disks import FitControl, fit_disks
from contactimg.imaging.fit.method import measure_by_fit
from contactimg.imaging.fit.problem import FitProblem
from contactimg.imaging.pixels.blocks import BLOCK, block_means, is_background
from contactimg.imaging.pixels.robust import robust_std
from contactimg.imaging.reject.foreign_objects import NO_FOREIGN_OBJECTS
from contactimg.imaging.shapes.components import label_components
from contactimg.imaging.shapes.peaks import find_peaks

ROOMS = ("pipeline.", "tradeoff.")  # names within these rooms of the package; all others lie in the imaging


@dataclass(frozen=True)
class Case:
    """A special case of the imaging.

    Parameters
    ----------
    name : str
        What is switched off.
    replacements : dict
        Names within the imaging, and what takes their place.
    code : str
        Modules and functions that serve this case alone, separated by spaces.
    """

    name: str
    replacements: dict[str, Any]
    code: str = ""


def find_nothing(*_: Any, **__: Any) -> FarSearch:
    """Far search: no shift."""
    return FarSearch(None, textured=True)


def divide_plainly(frame, reference, _half, illumination, *, residual, level, blur_px=0.0):
    """Wiener weights: the moved reference as it is, or behind a fixed blur."""
    make = partial(_moved_gaussian, width=blur_px) if blur_px else shift_kernel
    kernels = [make(part) for part in (residual.x_px, residual.y_px)]
    moved = filter_rows_and_columns(np.ascontiguousarray(reference), *kernels)
    background = illumination.ratio_at_rows(np.arange(frame.shape[0]), frame.shape) * moved
    return np.asarray(
        level * (frame - background) / np.maximum(background, DARKEST_FRACTION * level), np.float32
    )


def divide_by_one_band(frame, reference, _half, illumination, *, residual, level):
    """Wiener weights: one, of what lies between two widths; dirt as it is."""
    shape = (frame.shape[0], frame.shape[1])
    ratio = illumination.ratio_at_rows(np.arange(shape[0]), shape)
    kernels = [shift_kernel(part) for part in (residual.x_px, residual.y_px)]
    moved = filter_rows_and_columns(np.ascontiguousarray(reference), *kernels)
    narrow, wide = (cv2.GaussianBlur(moved, (0, 0), width) for width in (NARROW_PX, WIDE_PX))
    mask = is_background(illumination.background, *(np.arange(size) for size in shape), shape)
    detail, rest = (cv2.GaussianBlur(part, (0, 0), BLUR_PX) for part in (narrow - wide, frame / ratio - wide))
    scatter = robust_std((narrow - wide)[mask])
    usual = mask & (np.abs(narrow - wide) < DIRT_SIGMA * scatter)
    rest = rest - np.median(rest[usual])
    usual &= np.abs(rest) < OUTLIER_SIGMA * robust_std(rest[usual])
    gain = float(np.clip(np.sum((detail * rest)[usual]) / np.sum((detail**2)[usual]), 0.0, 1.5))
    surface = np.where(np.abs(narrow - wide) < DIRT_SIGMA * scatter, wide + gain * (narrow - wide), moved)
    background = ratio * surface
    return np.asarray(
        level * (frame - background) / np.maximum(background, DARKEST_FRACTION * level), np.float32
    )


def find_illumination_in_blocks(means, shape, *, background_is):
    """Illumination in crowds: from blocks, as elsewhere."""
    blocks, _ = means(BLOCK)
    level, scatter = find_background_level(blocks, background_is=background_is)
    return fit_illumination(blocks, shape, level=level, scatter=scatter)


def take_constant_background(frame, *, valid=None, dark=False):
    """Background without reference: the most common level."""
    sign = -1.0 if dark else 1.0
    blocks = sign * block_means(frame, valid)
    level, scatter = find_background_level(blocks, background_is="lowest")
    coefficients = np.zeros((4, 4))
    coefficients[0, 0] = sign * level
    background = np.abs(blocks - level) < BACKGROUND_CLIP_SIGMA * scatter
    image = np.asarray(frame - np.float32(sign * level), np.float32)
    illumination = Illumination(coefficients, background, scatter)
    return DifferenceImage(image, abs(level), np.ones_like(blocks), illumination, None)


def skip_envelope(blocks, _shape):
    """Envelope without reference: none, the polynomial starts from the most common level."""
    return Illumination(np.zeros((4, 4)), np.isfinite(blocks), 0.0)


def polarity_by_tail(frame, *, valid=None):
    """Polarity without reference: the longer tail of the grey levels."""
    tails = np.abs(np.quantile(frame, [0.005, 0.995]) - np.median(frame))
    dark = bool(tails[0] > tails[1])
    return estimate_background(frame, valid=valid, dark=dark), -1 if dark else 1


def find_no_peaks(*arguments, **options):
    """Residual peaks: none, and the height from which on one would count."""
    peaks, lowest = find_peaks(*arguments, **options)
    return peaks[:0], lowest


def replace_nothing(_problem, fit):
    """Other covers: none."""
    return Replacement(np.zeros(len(fit.disks), np.bool_), np.empty((0, 4)))


def skip_halo(problem, fit, *_, **__):
    """Halo: none."""
    return problem, fit, None, np.empty((0, 3))


def keep_illumination(problem, fit, *_, **__):
    """Rest of the illumination: left where it is."""
    return problem, fit


def fit_less_robustly(problem: FitProblem, disks: Any, *, control: FitControl, **options: Any) -> Any:
    """Robust weights and all rows: as in the fits before the last."""
    return fit_disks(problem, disks, control=replace(control, robust=False), **options)


def ignore_correlation(*_, **__):
    """Correlated noise: pixels are independent."""
    return NoiseCorrelation(np.zeros(LARGEST_LAG + 1))


def fit_sharp_edges(*arguments, film=None, **options):  # noqa: ARG001
    """Air film: none."""
    return measure_by_fit(*arguments, film=None, **options)


def label_only(image, level, *, marks=None, **_):
    """Splitting: components as they are."""
    found = label_components(image, level, marks=marks)
    return found, np.zeros(len(found), np.bool_)


def mark_none(position: int) -> Callable:
    """A function that marks none of the rows of its argument of that position."""
    return lambda *arguments, **_: np.zeros(len(arguments[position]), np.bool_)


def give(value: Any) -> Callable:
    """A function of a constant value."""
    return lambda *_, **__: value


CASES = {
    "far": Case(
        "far search for the shift",
        {"background.subtract.search_alignment": find_nothing},
        "background.align_far",
    ),
    "turn": Case(
        "rotation and scale in the far search",
        {"background.align_far._align_tiles": give(None)},
        "background.align_far._align_tiles background.align_far._fit_similarity",
    ),
    "closely": Case(
        "shift from all rows, or from dirt alone",
        {"background.subtract.align_all_rows": align_strips},
        "background.align.align_all_rows background.align._find_dirt",
    ),
    "wiener": Case(
        "Wiener weights of the reference: plain division",
        {"background.subtract.divide_by_reference": divide_plainly},
        "background.divide background.divide_rows",
    ),
    "fixed": Case(
        "Wiener weights of the reference: a fixed blur of 0.7 px",
        {"background.subtract.divide_by_reference": partial(divide_plainly, blur_px=NARROW_PX)},
        "background.divide background.divide_rows",
    ),
    "band": Case(
        "Wiener weights of the reference: one band",
        {"background.subtract.divide_by_reference": divide_by_one_band},
        "background.divide background.divide_rows",
    ),
    "squares": Case(
        "illumination from the gaps of a crowd",
        {"background.subtract.find_illumination": find_illumination_in_blocks},
        "background.find_illumination._scatter_of_darkest background.find_illumination.scatter_inside",
    ),
    "envelope": Case(
        "envelope of a crowd without reference",
        {"background.no_reference.CROWDED_FRACTION": -1.0},
        "background.no_reference._flatten_crowd",
    ),
    "background": Case(
        "background without reference: a constant",
        {
            "measure.estimate_background": take_constant_background,
            "background.no_reference.estimate_background": take_constant_background,
        },
        "background.no_reference",
    ),
    "opening": Case(
        "lower envelope before the polynomial, without reference",
        {"background.no_reference.fit_envelope": skip_envelope},
        "background.no_reference.fit_envelope",
    ),
    "roundness": Case(
        "polarity by roundness: by the longer tail",
        {"measure.estimate_either_background": polarity_by_tail},
        "background.no_reference.estimate_either_background background.no_reference._roundness",
    ),
    "mixed": Case(
        "contrast beside objects of another brightness",
        {"contrast.plateau._mixed": give(value=False)},
        "contrast.plateau._mixed contrast.plateau._keep_usual_objects",
    ),
    "contradiction": Case(
        "refusal of a contrast that the frame contradicts",
        {"reject.foreground._contradicts": give(value=False)},
        "reject.foreground._contradicts",
    ),
    "foreign": Case(
        "foreign objects",
        {"reject.foreground.find_foreign_objects": give(NO_FOREIGN_OBJECTS)},
        "reject.foreign_objects shapes.labelled_regions",
    ),
    "streaks": Case(
        "hot pixels and streaks",
        {"reject.foreign_objects._are_too_sharp": mark_none(1)},
        "reject.foreign_objects._are_too_sharp reject.foreign_objects._stand_alone",
    ),
    "dirt": Case(
        "dirt of the reference",
        {
            "reject.implausible_disks.find_reference_dust": mark_none(3),
            "reject.foreign_objects.find_reference_dust": mark_none(3),
            "count.method.find_reference_dust": mark_none(3),
        },
        "reject.reference_dust",
    ),
    "rimless": Case(
        "disks without a rim",
        {"reject.implausible_disks._lack_rim": mark_none(2)},
        "reject.implausible_disks._lack_rim",
    ),
    "halo": Case(
        "light scattered far (halo)",
        {"fit.method.remove_halo": skip_halo},
        "fit.halo fit.residual_light.remove_halo",
    ),
    "level": Case(
        "rest of the background after the fit",
        {"fit.method.remove_illumination": keep_illumination},
        "fit.residual_light.remove_illumination fit.residual_light._remaining_illumination",
    ),
    "rounds": Case(
        "rest of the background in turn with the fit: once", {"fit.residual_light.ILLUMINATION_ROUNDS": 1}
    ),
    "covers": Case(
        "other covers of groups that fit badly",
        {"fit.number_of_disks.find_better_covers": replace_nothing},
        "fit.covers fit.group_window shapes.arcs",
    ),
    "arcs": Case(
        "covers: circles through arcs of the outline",
        {"fit.covers.cover_outline": give(np.empty((0, 4)))},
        "shapes.arcs fit.covers._outline_covers fit.covers._completed",
    ),
    "pieces": Case(
        "covers: one disk more, or one cut in pieces",
        {"fit.covers._larger_covers": give(())},
        "fit.covers._larger_covers fit.covers._split",
    ),
    "peaks": Case("peaks of the residual", {"fit.number_of_disks.find_peaks": find_no_peaks}, "shapes.peaks"),
    "rims": Case(
        "peaks of the residual: higher limit at a rim",
        {"fit.number_of_disks.LEAST_PEAK_FRACTION": 0.0},
        "fit.number_of_disks._near_a_rim",
    ),
    "growth": Case(
        "bound of the radii of inscribed disks",
        {"fit.number_of_disks.INSCRIBED_GROWTH_RATIO": 1e6},
    ),
    "specks": Case("specks at a rim dropped", {"fit.significance.SPECK_RADIUS_PX": 0.0}),
    "inscribed": Case(
        "smoothing before disks are inscribed", {"fit.number_of_disks.SMOOTHED_CONTRAST_TO_NOISE": 0.0}
    ),
    "attempts": Case("disks told apart again at another contrast", {"fit.method.MOST_ATTEMPTS": 1}),
    "binning": Case(
        "binned pixels behind a wide blur",
        {"fit.method.WIDEST_UNBINNED_BLUR_PX": np.inf},
        "fit.problem._binned",
    ),
    "correlation": Case(
        "noise that neighbouring pixels share",
        {"fit.method.measure_correlation": ignore_correlation},
        "contrast.noise.NoiseCorrelation contrast.noise._autocorrelation contrast.noise._rim_autocorrelation "
        "contrast.noise._plateau_autocorrelation contrast.noise.measure_correlation "
        "contrast.noise._covariance contrast.noise._mark contrast.noise._clip contrast.noise._product",
    ),
    "plateaus": Case(
        "noise that neighbouring pixels share, in the spread of the contrasts",
        {
            "contrast.noise.NoiseCorrelation.plateau_inflation": lambda _, radius, *__, **___: np.ones(
                len(radius)
            )
        },
        "contrast.noise.NoiseCorrelation.plateau_inflation contrast.noise._plateau_autocorrelation",
    ),
    "settle": Case("common contrast and blur settled", {"fit.shared_optics.OPTICS_STEPS": 1}),
    "scatter": Case(
        "contacts that disagree about contrast and blur",
        {"fit.shared_optics.DiskScores._variance_factor": lambda _, least: max(least, 1.0)},
        "fit.shared_optics.DiskScores._variance_factor",
    ),
    "hidden": Case(
        "hidden rims in the uncertainty",
        {"fit.disks.visible_share": lambda disks: np.ones(len(disks))},
        "shapes.overlap.visible_share",
    ),
    "robust": Case(
        "robust weights and all rows in the last fit",
        dict.fromkeys(("fit.method.fit_disks", "fit.shared_optics.fit_disks"), fit_less_robustly),
    ),
    "film": Case("air film in the edge", {"measure.measure_by_fit": fit_sharp_edges}, "profile.film_rim"),
    "split": Case(
        "components split in counting",
        {"count.method.split_components": label_only},
        "count.split_touching",
    ),
    "slopes": Case(
        "counting: slope under specks",
        {"count.method._level_around": lambda _, found: np.zeros(len(found))},
        "count.method._level_around",
    ),
    "smoothing": Case(
        "counting: smoothing before noisy components are split", {"count.method.NOISY_CONTRAST_TO_NOISE": 0.0}
    ),
    "auto": Case("threshold by Otsu: 0.5", {"measure.choose_threshold": give(0.5)}, "count.threshold._otsu"),
    "pooling": Case(
        "contrast and blur of the series", {"pipeline.series.pool_optics": give(None)}, "fit.pooling"
    ),
    "choice": Case(
        "choice of the cheaper method: the fit",
        {"tradeoff.choice.count_error": give(np.inf)},
        "tradeoff.choice count.expected_error",
    ),
}


def check_names(cases: Iterable[Case] = tuple(CASES.values())) -> None:
    """Raise AttributeError or ModuleNotFoundError if a name that a case replaces or counts does not exist."""
    for case in cases:
        for name in (*case.replacements, *case.code.split()):
            resolve_name(full_name(name))


@contextmanager
def switched_off(key: str) -> Iterator[None]:
    """The package without a case."""
    with without(CASES[key]):
        yield


@contextmanager
def without(case: Case) -> Iterator[None]:
    """The same of a case of other tables."""
    with ExitStack() as stack:
        for name, new in case.replacements.items():
            stack.enter_context(patch(full_name(name), new))
        yield


@contextmanager
def watched(keys: Iterable[str]) -> Iterator[set[str]]:
    """The package with everything on; the set holds the cases that come into play, and all of constants."""
    called: set[str] = set()
    with ExitStack() as stack:
        for key in keys:
            for name, new in CASES[key].replacements.items():
                if callable(new):
                    watch = _watch(resolve_name(full_name(name)), key, called)
                    stack.enter_context(patch(full_name(name), watch))
                else:
                    called.add(key)
        yield called


def _watch(function: Callable, key: str, called: set[str]) -> Callable:
    """The function, which notes the case when it is called."""

    def noted(*arguments: Any, **options: Any) -> Any:
        called.add(key)
        return function(*arguments, **options)

    return noted


def count_lines(key: str) -> int:
    """Lines of code that serve a case alone, without comments, docstrings and blank lines."""
    return sum(_count_lines(resolve_name(full_name(name))) for name in CASES[key].code.split())


def full_name(name: str) -> str:
    """The name of a thing of the package as Python imports it."""
    return f"contactimg.{name}" if name.startswith(ROOMS) else f"contactimg.imaging.{name}"


def _count_lines(thing: Any) -> int:
    """Lines of code of a module, class or function."""
    thing = inspect.unwrap(getattr(thing, "py_func", thing))
    source = inspect.cleandoc("\n" + inspect.getsource(thing))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    texts = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, documented) and ast.get_docstring(node) is not None
        for line in range(node.body[0].lineno, node.body[0].end_lineno + 1)
    }
    no_code = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    no_code |= {tokenize.ENDMARKER}
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    lines = {
        n for token in tokens if token.type not in no_code for n in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - texts)
