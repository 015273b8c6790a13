"""A measured series: sample coordinates, asperities and forces of its contacts, and its files."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg import files
from contactimg.analysis.annuli import FieldOfView
from contactimg.effects.local_law import LawPlan, decide_law, law_evidence
from contactimg.engine.parallel import in_parallel
from contactimg.files.runs import apex_record, frame_shift, pose_record
from contactimg.forces import fill_forces, sphere_radii
from contactimg.pipeline.frame import MeasuredFrame, locate_contacts
from contactimg.pipeline.inputs import contact_sites
from contactimg.pipeline.pooled_background import evenly_spread
from contactimg.plausibility import FORCES_OFF_LOAD, doubts_about_match, mean_spacing, settle
from contactimg.pose import Pose, fit
from contactimg.pose.apex import SIGNIFICANT_STDS, STATED, Apex, find_apex, find_centre
from contactimg.pose.pairs import FEWEST_CONTACTS, PAIRING_FRACTION, pair_points, pairing_distance
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, FRAMES, NO_RESULT, OUTLINES, REJECTED, Flag, Schema, Status

logger = logging.getLogger(__name__)

BLOCK_FRAMES = 20
"""Frames whose tables are made at once. Chosen for memory: 20 frames of 1000 contacts take 6 MB, and each
process has some blocks waiting."""

_TABLES = (CONTACTS, FRAMES, REJECTED, OUTLINES)

BORDER_WIDTH, CUT_SHARE = 0.1, 0.1
"""Width of the border of a frame over its shorter side, and share of the area of contact there from which
contacts beyond it bear load too. By hand, on parts of the frames of SA+: of those that show less than two
thirds of the forces one of a hundred has less there, of those that show 95 % and more one of six has more."""

Result = TypeVar("Result")

# --- pose and apex


def find_pose(run: files.Run, sites: pd.DataFrame | None, guess: Pose) -> fit.PoseFit:
    """The pose of a series: the one that the contacts of a frame confirm, or the stated one.

    The contacts are looked for near the stated pose, or else anywhere on the sample.

    Parameters
    ----------
    run : Run
        Of one frame of the series, that with most contacts.
    sites : DataFrame or None
        Composite summits of the asperities.
    guess : Pose
        As stated.
    """
    if sites is None or run.scene.measure.pose != "fit":
        return fit.PoseFit(guess)
    shift = frame_shift(run.frames, run.frames["frame"].iloc[0])
    x_px, y_px = run.contacts["x_px"] - shift[0], run.contacts["y_px"] - shift[1]
    # the stated centre may err by 5 % of the longer side: chosen by hand; sensitivity not measured
    reach = 0.05 * max(guess.shape) * guess.pixel_size
    found = fit.fit_pose(x_px, y_px, sites[["x_m", "y_m"]], guess, largest_shift=reach)
    pose, known = found.pose, f"{found.n_matched} of {found.n_points} contacts fall on asperities"
    turned, mirrored = np.abs(np.sin(pose.rotation - guess.rotation)), pose.mirrored != guess.mirrored
    away = turned > np.sin(fit.LARGEST_TURN_RAD) or mirrored
    if away or np.hypot(*np.subtract(pose.centre, guess.centre)) > reach:
        stated = run.scene.camera is not None and run.scene.camera.centre is not None
        place, flag = ", ".join(f"{value:.6g}" for value in pose.centre), str(pose.mirrored).lower()
        keys = f"centre_m = [{place}], rotation_deg = {np.rad2deg(pose.rotation):.4g}, mirrored = {flag}"
        # 0.996 is chosen: within 5 degrees of a right angle, which exchanged columns are when mirrored
        hint = "; are x_m and y_m of the asperities exchanged?" if mirrored and turned > 0.996 else ""
        said = f"the camera does not look where [camera] says; {known} with [camera] {keys}: used here{hint}"
        logger.log(logging.WARNING if stated or away else logging.INFO, said)
    if abs(pose.pixel_size - guess.pixel_size) > fit.LARGEST_SCALE_ERROR * guess.pixel_size:
        sizes = f"[camera] pixel_size_m = {pose.pixel_size:.4g}, not {guess.pixel_size:.4g}"
        doubt = "is the scene wrong, or the scale of x_m and y_m?"
        logger.warning("contacts fall on asperities with %s: used here; %s", sizes, doubt)
    said = f"fitted: {known}, RMS {found.residual:.3g} m" if found.fitted else "as given"
    logger.info("pose %s", said)
    return found


def apex_of(scene: Scene, shown: Apex | None, asperities: pd.DataFrame | None) -> Apex | None:
    """The apex that a scene states, or else the one that the contacts show; None without an indenter."""
    if scene.indenter is None:
        return None
    stated = "apex" in scene.indenter.model_fields_set or (shown is None and asperities is None)
    if not stated and shown is None:
        said = "[indenter] apex_m is not stated, and the contacts do not show it: (%g, %g) m is taken"
        logger.warning(f"{said}; state it for overlay and analyse", *scene.indenter.apex)
    return Apex(scene.indenter.apex) if stated else shown


def shown_apex(run: files.Run, pose: Pose, asperities: pd.DataFrame | None) -> Apex | None:
    """The apex that the contacts of one frame of a run show, the frame that shows it best; None if none does.

    Without asperities it is the centre of the contacts.
    """
    if run.scene.indenter is None:
        return None
    contacts, frames, lens = run.contacts, run.frames, run.scene.indenter.radius
    lost = frames.loc[frames["status"] == Status.NO_POSE, "frame"]
    used = ~contacts["frame"].isin(lost) & (contacts["asperity"].notna() if asperities is not None else True)
    found = []
    for name, part in contacts[used].groupby("frame"):
        in_view = FieldOfView(pose, frame_shift(frames, str(name))).holds
        if asperities is None:
            apex = find_centre(part[["x_m", "y_m"]], part["area_m2"], in_view=in_view)
        else:
            caps = asperities.iloc[part["asperity"].to_numpy(int)]
            radius = caps["radius_m"].to_numpy(float)
            places, composite = caps[["x_m", "y_m"]], radius / (1 + radius / lens)
            apex = find_apex(places, caps["height_m"], composite, part["radius_m"], in_view=in_view)
        if apex is not None:
            found.append(apex)
    return min(found, key=lambda apex: np.hypot(*apex.std), default=None)


def doubt_match(run: files.Run, pose: Pose, asperities: pd.DataFrame, name: str, **counts: int) -> None:
    """Stop where too few of the ``measured`` and ``predicted`` contacts of a run are ``matched``."""
    shown, spacing = shown_apex(run, pose, asperities), mean_spacing(asperities)
    settle(doubts_about_match(run.scene, **counts, shown=shown, spacing=spacing), name)


# --- contacts with sample coordinates and forces


def locate_frames(
    contacts: pd.DataFrame, frames: pd.DataFrame, pose: Pose, targets: NDArray[np.float64] | None
) -> pd.DataFrame:
    """The contacts of frames in sample coordinates, each with its asperity.

    Where few contacts of a frame fall on one, they may have moved together, as under a tangential load: they
    are paired after a common shift, up to the spacing of the asperities, if nearly all fall on one then.
    """
    shifts = frames.set_index("frame")[["shift_x_px", "shift_y_px"]].reindex(contacts["frame"])
    shift_x, shift_y = np.nan_to_num(shifts.to_numpy(float).T, nan=0.0)
    located = locate_contacts(contacts, pose, shift_px=(shift_x, shift_y))
    if targets is None:
        return located
    points = located[["x_m", "y_m"]].to_numpy(float)
    asperity, reach = np.full(len(located), -1), pairing_distance(targets, pose)
    for rows in contacts.groupby("frame").indices.values():
        i, j, _ = pair_points(points[rows], targets, max_distance=reach)
        if len(i) < fit.NEARLY_ALL * len(rows) and len(rows) >= FEWEST_CONTACTS:
            shift = fit.common_shift(points[rows], targets, near=reach, far=reach / PAIRING_FRACTION)
            moved = pair_points(points[rows] - shift, targets, max_distance=reach)
            i, j, _ = moved if len(moved[0]) >= fit.NEARLY_ALL * len(rows) else (i, j, _)
        asperity[rows[i]] = j
    return located.assign(asperity=pd.arrays.IntegerArray(asperity, asperity < 0))


def _noted(frames: pd.DataFrame, notes: Mapping[Any, str], status: Status | None = None) -> pd.DataFrame:
    """The frames with notes added to the messages of those named.

    A ``status``, which leaves no result to rely on, takes the place of every one that leaves a result; its
    note then stands first.
    """
    changed = ~frames["status"].isin(NO_RESULT) & frames["frame"].isin(list(notes)) & (status is not None)
    messages = [
        "; ".join(filter(None, (notes.get(name, ""), message)[:: 1 if first else -1]))
        for name, message, first in zip(frames["frame"], frames["message"], changed, strict=True)
    ]
    return frames.assign(message=messages, status=frames["status"].mask(changed, status))


def _known(contacts: pd.DataFrame, column: str) -> pd.DataFrame:
    """Number of contacts of each frame that have a value in a column, ``known``, and of ``all``."""
    return pd.DataFrame(contacts[column].notna().groupby(contacts["frame"]).agg(known="sum", all="size"))


def with_pose(run: files.Run, sites: pd.DataFrame | None, pose: fit.PoseFit | None) -> files.Run:
    """The run with sample coordinates and asperities under a pose; as it is without one."""
    if pose is None:
        return run
    targets = None if sites is None else sites[["x_m", "y_m"]].to_numpy(float)
    frames = run.frames
    located = CONTACTS.conform(locate_frames(run.contacts, frames, pose.pose, targets))
    frames = _noted(frames, cut_frames(located, pose.pose.shape))
    if targets is not None:
        counts = _known(located, "asperity")
        few = counts[counts["known"] < fit.NEARLY_ALL * counts["all"]]
        lost = few[(few["known"] < fit.SIGNIFICANT_FRACTION * few["all"]) & (few["all"] >= FEWEST_CONTACTS)]
        notes = {
            name: f"only {found} of {count} contacts fall on an asperity: check the asperity table, [camera] "
            "pixel_size_m and centre_m, and [indenter] apex_m"
            for name, found, count in few.itertuples()
        }
        told = {name: notes.pop(name) for name in lost.index}
        frames = _noted(_noted(frames, notes), told, Status.NO_POSE)
    return replace(run, contacts=located, frames=frames, pose=pose)


def with_forces(run: files.Run, sites: pd.DataFrame | None, law: LawPlan | None) -> files.Run:
    """The run with local forces where the elastic body and the asperity's radius are known, and with sums.

    Without a pose it stays as it is.
    """
    if run.pose is None:
        return run
    lengths = {"pixel_size": run.pose.pose.pixel_size, "length_relative_std": run.pose.length_relative_std}
    scene = run.scene if law is None else law.scene
    contacts, frames = fill_forces(scene, run.contacts, run.frames, sites, **lengths)
    notes = {
        name: f"{count - found} contacts have no force, for want of an asperity or of a law for contacts "
        "so wide; the sum leaves them out"
        for name, found, count in _known(contacts, "force_N").itertuples()
        if 0 < found < count
    }
    frames = _noted(frames, notes)
    if law is not None:
        cut = frames["frame"].isin(list(cut_frames(contacts, run.pose.pose.shape)))
        frames = _noted(frames, _unbalanced(frames, law.scene, cut), Status.OFF_LOAD)
    return replace(run, contacts=contacts, frames=frames)


def cut_frames(contacts: pd.DataFrame, shape: tuple[int, int]) -> dict[Any, str]:
    """Name of a frame of which contacts lie along the border or are cut by a hole -> what is missing."""
    x, y = contacts["x_px"], contacts["y_px"]
    inside = np.minimum.reduce([x, shape[1] - 1 - x, y, shape[0] - 1 - y])
    outer = (inside < BORDER_WIDTH * min(shape)) | (contacts["flags"] & int(Flag.EDGE) > 0)
    sums = contacts[["area_m2"]].assign(outer=contacts["area_m2"].where(outer, 0.0))
    sums = sums.groupby(contacts["frame"]).sum()
    cut = sums.index[sums["outer"] > CUT_SHARE * sums["area_m2"]]
    return dict.fromkeys(cut, "contacts lie along the border: area and forces beyond it are missing")


def _unbalanced(frames: pd.DataFrame, scene: Scene, cut: pd.Series) -> dict[str, str]:
    """Name of a frame whose forces do not balance the load -> what to check.

    Where the frame cuts the apparent contact the forces on the rest are not known: only more is a fault.
    """
    total, load = frames["force_sum_N"], frames["load_N"]
    std = np.hypot(frames["force_sum_std_N"], scene.load.zero_std or 0.0)
    allowed = (1 - 1 / FORCES_OFF_LOAD) * np.maximum(total.abs(), load.abs())
    apart = (total - load).abs() > np.maximum(SIGNIFICANT_STDS * std, allowed)
    off = frames[apart & (total != 0) & (~cut | (total > load))]
    modulus = scene.need("elastic", "computing local forces").young_modulus
    shift = scene.measure.edge_shift_px if scene.measure.method == "disk" else 0.0
    edge = f"[measure] edge_shift_px = {shift:g}, " if shift else ""
    return {
        name: f"the local forces add up to {forces:.3g} N at a load of {load:.3g} N: check the load and its "
        f"zero, {edge}[elastic] young_modulus_Pa = {modulus:g}, [camera] pixel_size_m and the asperities' "
        "radii"
        for name, forces, load in off[["frame", "force_sum_N", "load_N"]].itertuples(index=False)
    }


# --- the series


@dataclass(frozen=True, eq=False)
class MeasuredSeries:
    """The measured frames of a series, with the pose of the camera over all of them.

    Parameters
    ----------
    scene : Scene
    parts : sequence of MeasuredFrame
        In order, with the load of each in its row.
    sites : DataFrame or None
        Composite summits of the asperities.
    pose : PoseFit or None
        None without a pixel size.
    apex : Apex or None
        None without an indenter.
    shown : Apex or None
        Apex and radius of the lens that the contacts show, None where they show none.
    law : LawPlan or None
        The law of the local forces, on which the contacts of all frames decide; None without forces.
    """

    scene: Scene
    parts: Sequence[MeasuredFrame]
    sites: pd.DataFrame | None
    pose: fit.PoseFit | None = None
    apex: Apex | None = None
    shown: Apex | None = None
    law: LawPlan | None = None

    def posed(self, asperities: pd.DataFrame | None = None) -> "MeasuredSeries":
        """The series with the pose and apex that the frame with most contacts gives, and the law of forces.

        Where an asperity first touches depends on the apex, by less than the asperities are apart: where the
        apex is found from the contacts, the pose is found once more.
        """
        if self.scene.camera is None:
            return self
        counts = pd.Series([part.row.get("n_contacts") for part in self.parts], dtype="Int64")
        run = replace(self, parts=[self.parts[int(counts.fillna(0).argmax())]]).in_pixels
        shape = next(part.shape for part in self.parts if part.shape)
        pose = find_pose(run, self.sites, self.scene.pose(shape))
        several = replace(self, parts=evenly_spread(self.parts, BLOCK_FRAMES), pose=pose)
        shown = shown_apex(several.located, pose.pose, asperities)
        apex = apex_of(self.scene, shown, asperities)
        posed = replace(self, pose=pose, apex=apex, shown=shown)
        if apex is not None and apex.known != STATED and asperities is not None:
            logger.info("%s", apex.sentence())
            scene = self.scene.with_apex(apex.place)
            sites = contact_sites(asperities, scene)
            posed = replace(posed, scene=scene, sites=sites, pose=find_pose(run, sites, pose.pose))
        return posed.with_law()

    def with_law(self) -> "MeasuredSeries":
        """The series with the law of the local forces that its contacts call for, if there is a body."""
        if self.scene.elastic is None:
            return self

        def evidence(block: MeasuredSeries) -> pd.DataFrame:
            contacts = block.located.contacts
            return law_evidence(block.scene, contacts, sphere_radii(contacts, block.scene, block.sites))

        return replace(self, law=decide_law(self.scene, pd.concat(self.of_blocks(evidence))))

    def blocks(self) -> Iterator["MeasuredSeries"]:
        """The series, a few frames at a time; a short one is its only block, which keeps its tables."""
        if len(self.parts) <= BLOCK_FRAMES:
            return iter((self,))
        firsts = range(0, len(self.parts), BLOCK_FRAMES)
        return (replace(self, parts=self.parts[k : k + BLOCK_FRAMES]) for k in firsts)

    def of_blocks(self, make: Callable[["MeasuredSeries"], Result]) -> Iterator[Result]:
        """The results of a function for the blocks, in order; several processes share the blocks."""
        count = -(-len(self.parts) // BLOCK_FRAMES)
        return in_parallel(make, ((block,) for block in self.blocks()), count=count)

    @cached_property
    def run(self) -> files.Run:
        """The tables of all frames in memory, with pose and forces."""
        return with_forces(self.located, self.sites, self.law)

    @property
    def located(self) -> files.Run:
        """The run without forces."""
        return with_pose(self.in_pixels, self.sites, self.pose)

    @property
    def in_pixels(self) -> files.Run:
        """The run in pixels."""
        parts, schemas = [part.tables for part in self.parts], (CONTACTS, REJECTED, OUTLINES)
        tables = {one.name: one.joined(getattr(part, one.name) for part in parts) for one in schemas}
        frames = FRAMES.conform(pd.DataFrame([part.row for part in self.parts]))
        return files.Run(self.scene, tables.pop(CONTACTS.name), frames, tables=tables)


def write_run(
    series: MeasuredSeries, folder: Path, table_format: files.TableFormat = "csv"
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Write contacts, frames, rejected and, if any, outlines, a few frames at a time.

    Returns
    -------
    frames : DataFrame
        The frames table.
    record : dict
        What the provenance must state of pose, law of the forces and air film.
    """
    record: dict[str, Any] = {} if series.pose is None else {"pose": pose_record(series.pose)}
    if series.apex is not None:
        record |= {"apex": apex_record(series.apex)}
    frames = list[pd.DataFrame]()
    with ExitStack() as stack:
        tables = [stack.enter_context(files.TableWriter(schema, folder, table_format)) for schema in _TABLES]

        def encoded(block: MeasuredSeries) -> tuple[list[str | pd.DataFrame], pd.DataFrame]:
            rows = [files.encoded_rows(getattr(block.run, one.name), one, table_format) for one in _TABLES]
            return rows, block.run.frames

        for contents, rows in series.of_blocks(encoded):
            for table, part in zip(tables, contents, strict=True):
                table.append(part)
            frames.append(rows)
    if tables[-1].empty:
        tables[-1].path.unlink()
    whole = FRAMES.joined(frames)
    if series.law is not None and whole["law"].ne("").any():
        record["law"] = series.law.sentence()
    films = {part.row["frame"]: asdict(part.film) for part in series.parts if part.film is not None}
    return whole, record | ({"film": films} if films else {})


def write_joined_tables(
    runs: Mapping[str, Path], target: Path, *, command: str, table_format: files.TableFormat = "csv"
) -> None:
    """Write the tables all_contacts and all_frames of several runs, with the name of the run first.

    Parameters
    ----------
    runs : mapping
        Name -> output folder of `process`.
    target : Path
        The folder to write, with its provenance.
    command : str
        For the provenance.
    table_format : {"csv", "parquet"}
    """
    tables = {name: files.read_run(folder) for name, folder in runs.items()}
    record = files.provenance(command=command, inputs=files.main_tables(runs.values()))
    with files.OutputFolder(target, record, main_files=[f"all_frames.{table_format}"]) as out:
        for schema in (CONTACTS, FRAMES):
            parts = [getattr(run, schema.name).assign(run=name) for name, run in tables.items()]
            named = {"run": ("str", "name of the folder of frames")} | schema.columns
            joined = Schema(f"all_{schema.name}", schema.description, **named)
            with files.TableWriter(joined, out.folder, table_format) as table:
                table.append(files.encoded_rows(pd.concat(parts, ignore_index=True), joined, table_format))
