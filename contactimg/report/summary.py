"""The first page of a report: what was measured, the numbers that matter with their intervals, and doubts."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.analysis.estimates import Estimate
from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.coverage_estimate import CoverageEstimate
from contactimg.calibration.threshold import load_slope
from contactimg.errors import InputError
from contactimg.files import Run
from contactimg.plots.numbers import number_with_interval, number_with_std, plain_number
from contactimg.report.units import display_unit
from contactimg.scene import Scene
from contactimg.tables import Status

MOST_NAMES = 3
"""Frames that a warning names. Chosen: a line."""
MOST_WARNINGS = 6
"""Warnings on the first page; the others are counted. Chosen: the page holds them in print."""
NO_WARNING = frozenset({Status.OK, Status.NO_CONTACT})


@dataclass(frozen=True)
class Headline:
    """A number that matters.

    Parameters
    ----------
    name, text, note : str
        What it is, the number with interval and unit, and where it comes from.
    """

    name: str
    text: str
    note: str = ""


@dataclass(frozen=True)
class Summary:
    """The words of the first page.

    Parameters
    ----------
    title : str
    facts : list of (str, str)
        What was measured, and how.
    headlines : list of Headline
    warnings : list of str
        Sentences.
    """

    title: str
    facts: list[tuple[str, str]]
    headlines: list[Headline]
    warnings: list[str]


@dataclass(frozen=True)
class Exponent:
    """The exponent of A(P).

    Parameters
    ----------
    estimate : Estimate
    confidence : float
        Of its interval.
    n_points : int
    """

    estimate: Estimate
    confidence: float
    n_points: int


def summarise(run: Run, exponent: Exponent | None, others: list[str]) -> Summary:
    """The words of the first page.

    Parameters
    ----------
    run : Run
    exponent : Exponent or None
    others : list of str
        Warnings about outputs of other commands.
    """
    warnings = [*_changed(run), *others, *_status_warnings(run.frames)]
    more = len(warnings) - MOST_WARNINGS
    if more > 0:
        warnings = [*warnings[:MOST_WARNINGS], f"{more} more warnings are in the table of the frames."]
    return Summary(_title(run), _facts(run), _headlines(run, exponent), warnings)


def _title(run: Run) -> str:
    """The bodies and the number of frames."""
    count = len(run.frames)
    number = "one frame" if count == 1 else f"{count} frames"
    if run.command == "predict":
        number = "predicted at one load" if count == 1 else f"predicted at {count} loads"
    return f"{_bodies(run.scene)}: {number}{_range_of(run.frames['load_N'], ', {} mN', 1e3)}"


def _bodies(scene: Scene | None) -> str:
    """What touches what."""
    if scene is None or scene.indenter is None:
        return "Contact micrographs"
    rough = scene.asperities is not None
    soft = rough and scene.asperities is not None and scene.asperities.textured == "soft"
    lens = "Textured lens" if rough and not soft else "Smooth lens"
    rubber = "textured rubber" if soft else "smooth rubber"
    return f"{lens} of radius {plain_number(1e3 * scene.indenter.radius)} mm on {rubber}"


def _range_of(values: pd.Series, form: str, factor: float) -> str:
    """Smallest and largest value; empty if none is known."""
    known = values.dropna().to_numpy(float) * factor
    if not len(known):
        return ""
    ends = dict.fromkeys(plain_number(float(end)) for end in (known.min(), known.max()))
    return form.format(" to ".join(ends))


def _facts(run: Run) -> list[tuple[str, str]]:
    """What was measured, and how."""
    scene, facts = run.scene, list[tuple[str, str]]()
    if scene is not None:
        if scene.indenter is not None:
            facts.append(("Lens", f"radius {plain_number(1e3 * scene.indenter.radius)} mm"))
        facts += _rubber(scene)
        if scene.asperities is not None and scene.asperities.file is not None:
            facts.append(("Asperities", Path(scene.asperities.file).name))
    loads = _range_of(run.frames["load_N"], "; loads {} mN", 1e3)
    facts.append(("Frames", f"{len(run.frames)}{_size(run)}{loads or '; loads not known'}"))
    if scene is not None and run.command != "predict":
        facts.append(("Method", _method(run, scene)))
    law = str(run.provenance.get("law", ""))
    if law:
        said = law.removeprefix("local forces by the ").rstrip(".")
        facts.append(("Local forces", f"{said[:1].upper()}{said[1:]}."))
    return facts


def _rubber(scene: Scene) -> list[tuple[str, str]]:
    """The elastic body."""
    body = scene.elastic
    if body is None:
        return []
    parts = []
    if body.stated_modulus is not None:
        modulus = number_with_std(1e-6 * body.stated_modulus, 1e-6 * body.young_modulus_std)
        parts.append(f"E = {modulus} MPa")
    parts.append(f"ν = {plain_number(body.poisson_ratio)}")
    if body.thickness is not None:
        parts.append(f"layer of {plain_number(1e3 * body.thickness)} mm")
    if body.work_of_adhesion:
        parts.append(f"w = {plain_number(1e3 * body.work_of_adhesion)} mJ/m²")
    return [("Rubber", ", ".join(parts))]


def _size(run: Run) -> str:
    """Size of the frames and of a pixel, where the run knows them."""
    pose = run.provenance.get("pose")
    if not pose:
        return ""
    pixel = plain_number(1e6 * pose["pixel_size_m"])
    return f" of {pose['columns']} × {pose['rows']} pixels, {pixel} µm per pixel"


def _method(run: Run, scene: Scene) -> str:
    """How contacts were measured."""
    method = "disks fitted to the image" if scene.measure.method == "disk" else "pixels above a threshold"
    if scene.measure.method != "disk":
        threshold = scene.measure.threshold
        method += " chosen for each frame" if threshold == "auto" else f" of {plain_number(threshold)}"
    reference = "reference image subtracted" if scene.images.reference else "no reference image"
    pose = run.provenance.get("pose") or {}
    seen = "; position of the camera not known"
    if pose.get("fitted"):
        matched = f"{pose['n_matched']} of {pose['n_points']} contacts on asperities"
        seen = f"; position of the camera from {matched}"
    elif pose:
        seen = "; position of the camera as the scene states it"
    return f"{method}; {reference}{seen}."


def _headlines(run: Run, exponent: Exponent | None) -> list[Headline]:
    """The numbers that matter."""
    frames, found = run.frames, list[Headline]()
    if exponent is not None:
        interval = f"{100 * exponent.confidence:g} % interval, {exponent.n_points} points"
        text = number_with_interval(exponent.estimate)
        found.append(Headline("m", text, f"exponent m of A ~ Pᵐ, {interval}"))
    slope = _force_slope(run)
    if slope is not None:
        note = "sum of the local forces over load, 95 % interval"
        found.append(Headline("ΣF/P", number_with_interval(slope), note))
    counts = frames["n_contacts"].dropna().to_numpy(int)
    each = _range_of(frames["n_contacts"], "{} in a frame", 1.0)
    found.append(Headline("Contacts", str(int(counts.sum())), each))
    known = frames[frames["area_m2"].notna()]
    if len(known):
        text, note = _areas(known)
        found.append(Headline("Area A", text, note))
    return found


def _areas(frames: pd.DataFrame) -> tuple[str, str]:
    """The smallest and the largest area, with the uncertainty of the latter."""
    ordered = frames.sort_values("area_m2")
    least, most = ordered.iloc[0], ordered.iloc[-1]
    factor, unit = display_unit(float(most["area_m2"]), "m2")
    text = number_with_std(factor * most["area_m2"], factor * most["area_std_m2"])
    if len(ordered) == 1:
        return f"{text} {unit}", "real contact area"
    low = number_with_std(factor * least["area_m2"], factor * least["area_std_m2"])
    return f"{low} to {text} {unit}", "real contact area, smallest and largest"


def _force_slope(run: Run) -> CoverageEstimate | None:
    """Slope of the sums of the local forces against the loads; None where there are none."""
    if run.scene is None or run.scene.elastic is None or run.command == "predict":
        return None
    good = run.frames[(run.frames["load_N"] > 0) & (run.frames["force_sum_N"] > 0)]
    load, cell, elastic = good["load_N"].to_numpy(float), LoadCell.stated(run.scene.load), run.scene.elastic
    relative = 0.0 if elastic.stated_modulus is None else elastic.young_modulus_std / elastic.stated_modulus
    try:
        return load_slope(
            good["force_sum_N"].to_numpy(float),
            load,
            relative_std=float(np.hypot(relative, cell.gain_std)),
            zero_std=cell.zero_width(load),
        )
    except InputError:
        return None


def _changed(run: Run) -> list[str]:
    """Tables that were changed after the run."""
    if not run.changed:
        return []
    names = " and ".join(run.changed)
    return [f"{names} changed after the run; numbers, areas and forces of the frames are summed anew."]


def _status_warnings(frames: pd.DataFrame) -> list[str]:
    """One sentence for each status that is not ok: how many frames, which, and what the first one says."""
    doubtful = frames[~frames["status"].isin(list(NO_WARNING))]
    return [
        _status_warning(str(status), part, len(frames))
        for status, part in doubtful.groupby("status", sort=False)
    ]


def _status_warning(status: str, part: pd.DataFrame, total: int) -> str:
    """The sentence of one status."""
    names = ", ".join(part["frame"].astype(str).head(MOST_NAMES))
    more = f" and {len(part) - MOST_NAMES} more" if len(part) > MOST_NAMES else ""
    message = str(part["message"].iloc[0] or "").rstrip(".")
    verb = "has" if len(part) == 1 else "have"
    sentence = (
        f"{len(part)} of {total} frame{'s' * (total > 1)} {verb} the status “{status}” ({names}{more})."
    )
    return f"{sentence} {message[:1].upper()}{message[1:]}." if message else sentence
