"""Synthetic series: solve the scene at each load, render the contacts, keep the true contacts."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.effects.plan import Plan
from contactimg.engine.parallel import in_parallel
from contactimg.errors import InputError
from contactimg.files import SCENE_FILE, write_frame, write_scene, write_table
from contactimg.optics.render_settings import rendered_effects
from contactimg.pipeline.inputs import contact_sites
from contactimg.prediction import make_mechanical_plan, predict_contacts
from contactimg.render import Rendered, render_contacts, render_reference, render_smooth_contact
from contactimg.scene import Scene
from contactimg.shear.laws import shear_contacts
from contactimg.surfaces import of_asperities
from contactimg.tables import ASPERITIES, CONTACTS, LOADS


def plan_simulation(scene: Scene, asperities: pd.DataFrame | None) -> tuple[Scene, tuple[Plan, ...]]:
    """Decide which effects the frames of a series show.

    A mechanical effect is computed if the plan of the smallest or of the largest load calls for it. Optics
    and sensor are rendered as ``[simulate]`` states them.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]``, ``[elastic]``, ``[camera]`` and ``[simulate]`` (with loads) are needed.
    asperities : DataFrame or None
        Asperity table; None for a smooth flat.

    Returns
    -------
    scene : Scene
        With every switch "on" or "off".
    plans : tuple of Plan
        Of its smallest and its largest load; empty for a smooth contact.

    Raises
    ------
    InputError
        If a section is missing or makes no sense.
    ModelRangeError
        If the indenter reaches the plane between the asperities.
    """
    simulate = scene.need("simulate", "simulating frames")
    scene.need("camera", "simulating frames")
    scene.check_effects()
    rendered_effects(scene)
    if asperities is None or not simulate.loads:
        return explicit_switches(scene), ()
    pressed = [load for load in simulate.loads if load > 0] or simulate.loads
    plans = tuple(
        make_mechanical_plan(scene, asperities, load=load) for load in sorted({min(pressed), max(pressed)})
    )
    decisions = [decision for plan in plans for decision in plan.decisions]
    on = {decision.effect for decision in decisions if decision.on}
    switches = {one.effect: "on" if one.effect in on else "off" for one in decisions}
    return explicit_switches(scene.with_effects(switches)), plans


def explicit_switches(scene: Scene) -> Scene:
    """The scene with its "auto" switches replaced by what it states.

    An effect of optics or sensor is on when its parameter is not zero; the air film is off. Of the mechanical
    effects, which `plan_simulation` sets before, coupling is on where there are asperities.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> scene = explicit_switches(scene_from_dict({"simulate": {"vignetting": 0.2}, "asperities": {}}))
    >>> scene.effects.vignetting, scene.effects.dust, scene.effects.coupling, scene.effects.film
    ('on', 'off', 'on', 'off')
    """
    shown = rendered_effects(scene) | ({"coupling"} if scene.asperities is not None else set())
    stated = scene.effects.switches()
    switches = {name: "on" if name in shown else "off" for name in stated if stated[name] == "auto"}
    return scene.with_effects(switches)


def write_simulation(scene: Scene, asperities: pd.DataFrame | None, folder: Path) -> None:
    """Write synthetic frames with loads, asperities, truth and scene, ready for `process`.

    Asperities touch by the interacting model; without any, the smooth sphere touches by JKR. The same scene
    gives the same frames.

    Parameters
    ----------
    scene : Scene
        Sections ``[indenter]``, ``[elastic]``, ``[camera]`` and ``[simulate]`` (with loads) are needed;
        switches at "auto" are set by `plan_simulation` and written as set.
    asperities : DataFrame or None
        Asperity table; None for a smooth flat.
    folder : Path
        Exists.

    Raises
    ------
    InputError
        If a section is missing or there is no load.
    """
    if "auto" in scene.effects.switches().values():
        scene, _ = plan_simulation(scene, asperities)
    simulate = scene.need("simulate", "simulating frames")
    if not simulate.loads:
        raise InputError("simulating frames needs at least one load in [simulate] loads_N; add it")
    if simulate.tangential and asperities is None:
        raise InputError("[simulate] tangential_N needs asperities; give [asperities], or leave it out")
    count = len(simulate.loads)
    names = [f"frame_{k:0{len(str(count))}d}.tif" for k in range(1, count + 1)]
    loads = pd.DataFrame({"frame": names, "load_N": simulate.loads})
    if simulate.tangential:
        loads["tangential_N"] = simulate.tangential
    if simulate.interval:
        loads["time_s"] = simulate.interval * np.arange(count)
    seeds = np.random.SeedSequence(simulate.seed).spawn(count + 1)
    reference = render_reference(scene, rng=np.random.default_rng(seeds[0]), name="reference.tif")
    write_frame(reference, folder / reference.name)
    sites = None if asperities is None else contact_sites(asperities, scene)

    def render(row: dict[str, Any], seed: np.random.SeedSequence) -> Rendered:
        """The frame of a row of loads: a smooth contact, or asperities with their radii on a sphere."""
        load, how = row["load_N"], {"rng": np.random.default_rng(seed), "name": row["frame"]}
        if asperities is None or sites is None:
            return render_smooth_contact(load, scene, **how)
        contacts = predict_contacts(scene, asperities, load=load, frame=row["frame"]).contacts
        if "tangential_N" in row:
            contacts = shear_contacts(contacts, scene, tangential=row["tangential_N"])
        radii = of_asperities(sites["radius_m"], contacts["asperity"])
        return render_contacts(contacts, scene, sphere_radius=radii, **how)

    jobs, truth = zip(loads.to_dict("records"), seeds[1:], strict=True), list[pd.DataFrame]()
    for rendered in in_parallel(render, jobs, count=count, shown="making frames"):
        write_frame(rendered.frame, folder / rendered.frame.name)
        truth.append(rendered.contacts)
    write_table(loads, LOADS.filled(loads), folder / "loads.csv")
    write_table(CONTACTS.joined(truth), CONTACTS, folder / "truth.csv")
    if asperities is not None:
        write_table(asperities, ASPERITIES, folder / "asperities.csv")
    write_scene(_measured_scene(scene), folder / SCENE_FILE)


def _measured_scene(scene: Scene) -> dict[str, Any]:
    """The scene as an experimenter would write it for the simulated folder."""
    data = dict(scene.source)
    if "asperities" in data:
        generated = ("generate", "coverage", "seed")
        kept = {key: value for key, value in data["asperities"].items() if key not in generated}
        data["asperities"] = kept | {"file": "asperities.csv"}
    images = {"reference": "reference.tif", "frames": "frame_*.tif", "loads": "loads.csv"}
    data["images"] = data.get("images", {}) | images
    paper = {"model": "paper"} if scene.effects.model == "paper" else {}
    data["effects"] = paper | scene.effects.switches()
    # synthetic frames are those of a linear camera
    camera = data.get("camera", {})
    data["camera"] = {key: value for key, value in camera.items() if key not in ("gamma", "response")}
    return data
