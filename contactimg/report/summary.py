"""The words of a report: what was measured, the numbers that matter with intervals, doubts, captions."""

from pathlib import Path

import pandas as pd

from contactimg.analysis.estimates import CoverageEstimate, Estimate
from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.threshold_and_modulus import load_slope
from contactimg.errors import InputError
from contactimg.files import Run
from contactimg.files.atomic import first_names
from contactimg.plots.numbers import display_unit, number_with_interval, number_with_std, plain_number
from contactimg.pose.fit import SIGNIFICANT_FRACTION
from contactimg.scene import Scene
from contactimg.tables import Status

Headline = tuple[str, str, str]
"""Name of a number, the number with interval and unit, and its origin."""

MOST_WARNINGS = 6
"""Most warnings on the first page; the others are counted. Chosen: the page holds them in print."""
NO_WARNING = frozenset({Status.OK, Status.NO_CONTACT})


def title(run: Run) -> str:
    """The bodies and the number of frames."""
    count = len(run.frames)
    number = "one frame" if count == 1 else f"{count} frames"
    if run.command == "predict":
        number = "predicted at one load" if count == 1 else f"predicted at {count} loads"
    bodies = "Contact micrographs"
    if run.scene.indenter is not None:
        textured = None if run.scene.asperities is None else run.scene.asperities.textured
        lens = "Textured lens" if textured == "rigid" else "Smooth lens"
        rubber = "textured rubber" if textured == "soft" else "smooth rubber"
        bodies = f"{lens} of radius {plain_number(1e3 * run.scene.indenter.radius)} mm on {rubber}"
    return f"{bodies}: {number}{_range_of(run.frames['load_N'], ', {} mN', 1e3)}"


def _range_of(values: pd.Series, form: str, factor: float) -> str:
    """Smallest and largest value; empty if none is known."""
    known = values.dropna().to_numpy(float) * factor
    if not len(known):
        return ""
    ends = dict.fromkeys(plain_number(float(end)) for end in (known.min(), known.max()))
    return form.format(" to ".join(ends))


def facts(run: Run) -> list[tuple[str, str]]:
    """The settings and results of a run, as pairs of name and text."""
    scene, found, pose = run.scene, list[tuple[str, str]](), run.provenance.get("pose")
    if scene.indenter is not None:
        found.append(("Lens", f"radius {plain_number(1e3 * scene.indenter.radius)} mm"))
    body = scene.elastic
    if body is not None:
        parts = [f"ν = {plain_number(body.poisson_ratio)}"]
        if body.stated_modulus is not None:
            modulus = number_with_std(1e-6 * body.stated_modulus, 1e-6 * body.young_modulus_std)
            parts.insert(0, f"E = {modulus} MPa")
        if body.thickness is not None:
            parts.append(f"layer of {plain_number(1e3 * body.thickness)} mm")
        if body.work_of_adhesion:
            parts.append(f"w = {plain_number(1e3 * body.work_of_adhesion)} mJ/m²")
        found.append(("Rubber", ", ".join(parts)))
    if scene.asperities is not None and scene.asperities.file is not None:
        found.append(("Asperities", Path(scene.asperities.file).name))
    loads, size = _range_of(run.frames["load_N"], "; loads {} mN", 1e3), ""
    if pose:
        pixel = plain_number(1e6 * pose["pixel_size_m"])
        size = f" of {pose['columns']} × {pose['rows']} pixels, {pixel} µm per pixel"
    found.append(("Frames", f"{len(run.frames)}{size}{loads or '; loads not known'}"))
    if run.command != "predict":
        found.append(("Method", _method(run, scene)))
    law = str(run.provenance.get("law", "")).removeprefix("local forces by the ").rstrip(".")
    if law:
        found.append(("Local forces", f"{law[:1].upper()}{law[1:]}."))
    return found


def _method(run: Run, scene: Scene) -> str:
    method, threshold = "disks fitted to the image", scene.measure.threshold
    if scene.measure.method != "disk":
        chosen = "chosen for each frame" if threshold == "auto" else f"of {plain_number(threshold)}"
        method = f"pixels above a threshold {chosen}"
    reference = "reference image subtracted" if scene.images.reference else "no reference image"
    pose = run.provenance.get("pose") or {}
    seen = "; position of the camera not known"
    if pose.get("fitted"):
        matched = f"{pose['n_matched']} of {pose['n_points']} contacts on asperities"
        seen = f"; position of the camera from {matched}"
    elif pose:
        seen = "; position of the camera as the scene states it"
    return f"{method}; {reference}{seen}."


def exponent_headline(exponent: Estimate, confidence: float, n_points: int) -> Headline:
    """The exponent of A(P)."""
    note = f"exponent m of A ~ Pᵐ, {100 * confidence:g} % interval, {n_points} points"
    return "m", number_with_interval(exponent), note


def headlines(run: Run) -> list[Headline]:
    """The numbers that matter, but for the exponent of A(P)."""
    frames, found = run.frames, list[Headline]()
    slope = _force_slope(run)
    if slope is not None:
        note = "sum of the local forces over load, 95 % interval"
        found.append(("ΣF/P", number_with_interval(slope), note))
    total = str(int(frames["n_contacts"].sum()))
    found.append(("Contacts", total, _range_of(frames["n_contacts"], "{} in a frame", 1.0)))
    known = frames[frames["area_m2"].notna()].sort_values("area_m2")
    if len(known):
        factor, unit = display_unit(float(known["area_m2"].iloc[-1]), "m2")
        ends = known.iloc[[0, -1]] if len(known) > 1 else known
        texts = [
            number_with_std(factor * area, factor * std)
            for area, std in ends[["area_m2", "area_std_m2"]].itertuples(index=False)
        ]
        note = "real contact area" + (", smallest and largest" if len(known) > 1 else "")
        found.append(("Area A", f"{' to '.join(texts)} {unit}", note))
    return found


def _force_slope(run: Run) -> CoverageEstimate | None:
    """Slope of the sums of the local forces against the loads; None where there are none.

    A frame counts if half of its contacts have a force, or more.
    """
    elastic = run.scene.elastic
    if elastic is None or run.command == "predict":
        return None
    known = run.contacts["force_N"].notna().groupby(run.contacts["frame"]).mean()
    good = run.frames[(run.frames["load_N"] > 0) & (run.frames["force_sum_N"] > 0)]
    good = good[good["frame"].map(known) >= SIGNIFICANT_FRACTION]
    relative = 0.0 if elastic.stated_modulus is None else elastic.young_modulus_std / elastic.stated_modulus
    errors = LoadCell.stated(run.scene.load).errors(relative)
    try:
        return load_slope(good["force_sum_N"].to_numpy(float), good["load_N"].to_numpy(float), **errors)
    except InputError:
        return None


def warnings(run: Run, others: list[str]) -> list[str]:
    """Sentences: tables that were changed after the run, the others, and each status that is not ok."""
    found = [*others]
    if run.changed:
        names = " and ".join(run.changed)
        changed = f"{names} changed after the run; numbers, areas and forces of the frames are summed anew."
        found.insert(0, changed)
    doubtful = run.frames[~run.frames["status"].isin(list(NO_WARNING))]
    for status, part in doubtful.groupby("status", sort=False):
        message = str(part["message"].iloc[0] or "").rstrip(".")
        total, verb = len(run.frames), "has" if len(part) == 1 else "have"
        count = f"{len(part)} of {total} frame{'s' * (total > 1)}"
        sentence = f"{count} {verb} the status “{status}” ({first_names(part['frame'].astype(str))})"
        first = ", the first" * (len(set(part["message"])) > 1)
        found.append(f"{sentence}{first}: {message}." if message else f"{sentence}.")
    left = len(found) - MOST_WARNINGS
    if left > 0:
        found = [*found[:MOST_WARNINGS], f"{left} more warnings are in the table of the frames."]
    return found


def caption_of_frame(run: Run, frame: str) -> str:
    """Caption of a frame: its load, contacts and area."""
    row = run.frames[run.frames["frame"] == frame].iloc[0]
    parts = [f"{frame}{_load(row)}"]
    if pd.notna(row["n_contacts"]):
        count = int(row["n_contacts"])
        parts.append("one contact" if count == 1 else f"{count} contacts")
    if pd.notna(row["area_m2"]):
        parts.append(f"area {number_with_std(1e6 * row['area_m2'], 1e6 * row['area_std_m2'])} mm²")
    return f"{', '.join(parts)}; status {row['status']}."


def caption_of_comparison(run: Run, frame: str) -> str:
    """Describe what a frame with predictions shows."""
    load = _load(run.frames[run.frames["frame"] == frame].iloc[0])
    return (
        f"Measured and predicted contacts on {frame}{load}, for each model: matched (thin, blue), measured "
        "and not predicted (thick, orange), predicted and not measured (thick dashes, yellow). Below, the "
        "white rectangle enlarged, with all predicted contacts (white dashes)."
    )


def _load(row: pd.Series) -> str:
    return f" at {plain_number(1e3 * row['load_N'])} mN" if pd.notna(row["load_N"]) else ""
