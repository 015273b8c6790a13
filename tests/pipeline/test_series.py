"""Series: change of units, memory, backends, order; one set of contacts whatever the road."""

import re
import shutil
import weakref
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_series import SCENE, copy_of, write_small_series

from contactimg.errors import FrameWarning, InputError
from contactimg.files import FrameSource, open_experiment, read_scene, write_frame, write_table
from contactimg.frame import Frame
from contactimg.mechanics import hertz
from contactimg.pipeline.calibrate.thresholds import measure_thresholds
from contactimg.pipeline.frame import measure_frame
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.pipeline.series import measure_parts, measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict
from contactimg.tables import ASPERITIES, CONTACTS, FRAMES


@pytest.fixture(scope="module")
def run(small_series):
    return measure_series(read_scene(small_series), workers=1)


def scaled_scene(scene, length, pressure):
    """The scene with every length and every pressure in other units; pixels stay."""
    data = {section: dict(keys) for section, keys in scene.source.items()}
    data["indenter"] = {key: (np.array(value) * length).tolist() for key, value in data["indenter"].items()}
    data["elastic"] = {key: value * pressure for key, value in data["elastic"].items()}
    data["camera"]["pixel_size_m"] *= length
    data["asperities"] = {"file": "asperities.csv"}
    light = scene.light  # its waves are lengths too
    data["light"] = {
        "film_wavelength_nm": light.film_wavelength_nm * length,
        "film_bandwidth_nm": light.film_bandwidth_nm * length,
        "film_range_nm": [edge * length for edge in light.film_range_nm],
    }
    return data


def test_change_of_units(small_series, tmp_path, run):
    length, pressure = 3.7, 0.23
    folder = copy_of(small_series, tmp_path / "scaled")
    asperities = pd.read_csv(folder / "asperities.csv")
    write_table(asperities * length, ASPERITIES, folder / "asperities.csv")
    data = scaled_scene(read_scene(folder), length, pressure)
    scaled = measure_series(scene_from_dict(data, folder=str(folder)), workers=1)
    powers = {"x_px": 1, "radius_px": 1, "x_m": length, "radius_m": length, "area_m2": length**2}
    powers |= {"force_N": pressure * length**2, "force_std_N": pressure * length**2}
    for column, factor in powers.items():
        # the pose is fitted to 1e-9 of a pixel; forces take its scale to the third power
        np.testing.assert_allclose(scaled.contacts[column], factor * run.contacts[column], rtol=1e-7)


def test_series_and_single_frame_measure_the_same_disks(small_series, run):
    scene = read_scene(small_series)
    frame = FrameSource("frame_3.tif", small_series / "frame_3.tif").read()
    reference = FrameSource("reference.tif", small_series / "reference.tif").read()
    alone = measure_frame(
        frame, reference, pixel_size=scene.camera.pixel_size, polarity="bright", threshold=0.5
    )
    together = run.contacts[run.contacts["frame"] == "frame_3.tif"]
    # with few contacts the frame takes contrast, blur and edge of the others, which are the same
    assert len(alone) == len(together)
    change = np.abs(alone["radius_px"].to_numpy() - together["radius_px"].to_numpy())
    assert (change < 0.2 * together["radius_std_px"].to_numpy()).all()


def test_memory_holds_few_frames_of_a_long_series(small_series, tmp_path, monkeypatch):
    folder = copy_of(small_series, tmp_path / "long")
    for k in range(4, 9):
        shutil.copy(folder / "frame_2.tif", folder / f"frame_{k}.tif")
    alive, most, read = set(), 0, FrameSource.read

    def counting(source):
        nonlocal most
        frame = read(source)
        alive.add(id(frame))
        weakref.finalize(frame, alive.discard, id(frame))
        most = max(most, len(alive))
        return frame

    monkeypatch.setattr(FrameSource, "read", counting)
    assert len(measure_series(read_scene(folder), workers=1).frames) == 8
    assert most <= 3  # the reference, the frame measured, the one that takes its place


def test_frames_come_in_natural_order(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "order")
    (folder / "frame_1.tif").rename(folder / "frame_10.tif")
    run = measure_series(read_scene(folder), workers=1)
    assert run.frames["frame"].tolist() == ["frame_2.tif", "frame_3.tif", "frame_10.tif"]


def test_tables_have_their_schema_also_without_any_contact(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "none")
    for k in (1, 2, 3):
        shutil.copy(folder / "reference.tif", folder / f"frame_{k}.tif")
    run = measure_series(read_scene(folder), workers=1)
    assert run.contacts.columns.tolist() == list(CONTACTS.columns)
    assert run.frames.columns.tolist() == list(FRAMES.columns)
    assert run.frames["area_m2"].tolist() == [0.0, 0.0, 0.0]
    assert not run.pose.fitted


def test_a_missing_modulus_is_told_before_frames_are_measured(tmp_path):
    (tmp_path / "frame_1.tif").write_bytes(b"an image that no one reads")
    keys = {"camera": {"pixel_size_m": 6e-6}, "elastic": {"poisson_ratio": 0.5}}
    scene = scene_from_dict(keys, folder=str(tmp_path))
    missing = re.escape(f"{tmp_path}: [elastic] young_modulus_Pa is missing")
    with pytest.raises(InputError, match=missing):
        measure_series(scene)
    with pytest.raises(InputError, match=missing):
        measure_thresholds(open_experiment(scene), [0.5])


def test_a_pixel_size_in_micrometres_is_refused():
    with pytest.raises(InputError, match=r"measure_frame: pixel_size_m = 6 is outside .* given in µm"):
        measure_frame(np.zeros((20, 20)), pixel_size=6)


def test_a_film_without_a_known_radius_is_refused():
    with pytest.raises(InputError, match="needs the radius of the asperities"):
        measure_frame(np.zeros((20, 20)), pixel_size=6e-6, film="on")
    with pytest.raises(InputError, match=r"pixel_size_m = 6 is outside .* given in µm"):
        measure_series(scene_from_dict({"camera": {"pixel_size_m": 6.0}}, folder="no_such_folder"))


def test_radius_unknown_means_no_force(small_series, tmp_path):
    data = {section: dict(keys) for section, keys in read_scene(small_series).source.items()}
    del data["asperities"]
    run = measure_series(scene_from_dict(data, folder=str(small_series)), workers=1)
    assert run.contacts["force_N"].isna().all()
    assert run.frames["force_sum_N"].isna().all()
    assert run.frames["area_m2"].gt(0).all()


def test_one_common_radius_gives_every_contact_a_force(small_series):
    data = {section: dict(keys) for section, keys in read_scene(small_series).source.items()}
    data["asperities"] = {"radius_m": 100e-6}
    run = measure_series(scene_from_dict(data, folder=str(small_series)), workers=1)
    assert run.contacts["asperity"].isna().all()
    np.testing.assert_allclose(run.frames["force_sum_N"], run.frames["load_N"], rtol=0.03)


def test_stated_modulus_error_enters_every_sum_alike(run):
    relative = SCENE["elastic"]["young_modulus_std_Pa"] / SCENE["elastic"]["young_modulus_Pa"]
    assert (run.frames["force_sum_std_N"] / run.frames["force_sum_N"]).between(relative, 2 * relative).all()


def test_a_frame_is_two_dimensional():
    with pytest.raises(ValueError, match=r"two dimensions .*read_frames reads files"):
        Frame(np.zeros((3, 4, 3), np.uint8))


def test_a_frame_that_shows_nothing_has_no_area_and_one_without_contact_has_none(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "empty")
    reference = FrameSource("reference.tif", folder / "reference.tif").read().image
    noise = np.random.default_rng(1).normal(0, 2.0, reference.shape)
    empty = np.clip(np.rint(reference + noise), 0, 255).astype(np.uint8)
    for name, image in (("frame_1", np.zeros_like(empty)), ("frame_2", empty)):
        write_frame(Frame(image, f"{name}.tif", 255.0), folder / f"{name}.tif")
    frames = measure_series(read_scene(folder), workers=1).frames.set_index("frame")
    black, bare = frames.loc["frame_1.tif"], frames.loc["frame_2.tif"]
    assert black["status"] == "black"
    assert black[["n_contacts", "area_m2", "area_std_m2", "force_sum_N"]].isna().all()
    assert (bare["status"], bare["n_contacts"], bare["area_m2"], bare["force_sum_N"]) == (
        "no contact",
        0,
        0,
        0,
    )
    # no contact means none that would have been seen, and one of half a pixel would
    assert 0 < bare["area_std_m2"] < np.pi * (0.7 * 6e-6) ** 2


def simulated(folder, effects, **simulate):
    """The small series with some effects rendered, and its truth."""
    data = SCENE | {"effects": SCENE["effects"] | effects, "simulate": SCENE["simulate"] | simulate}
    write_small_series(folder, data)
    return scene_from_dict(data), pd.read_csv(folder / "truth.csv")


def switched(folder, **effects):
    """The sums of a folder's frames with other switches."""
    data = {section: dict(keys) for section, keys in read_scene(folder).source.items()}
    data["effects"] = {"model": "paper"} | effects
    run = measure_series(scene_from_dict(data, folder=str(folder)), workers=1)
    return run.frames.set_index("frame")


def under_other_laws(folder, switch):
    """The sums of a folder's frames, measured once, with a law of the forces switched on and off."""
    series = measure_parts(open_experiment(read_scene(folder)))
    for state in ("on", "off"):
        effects = series.scene.effects.model_copy(update={switch: state})
        one = replace(series, scene=series.scene.model_copy(update={"effects": effects}))
        yield one.with_law().run.frames.set_index("frame")


@pytest.mark.slow
def test_film_switched_on_takes_its_rim_out_of_the_radii(tmp_path):
    _, truth = simulated(tmp_path / "film", {"film": "on"}, electrons_per_level=200)
    a = truth.groupby("frame")["radius_m"]
    with_rim = switched(tmp_path / "film", film="on")
    without = switched(tmp_path / "film", film="off")
    # at 6 um a pixel and a blur of 1.4 px a disk exceeds the contact by this much of its radius
    excess = a.transform(
        lambda r: np.interp(1e6 * r, [5, 10, 20, 30, 45], [0.106, 0.048, 0.019, 0.011, 0.007])
    )
    for name, column, power in (("area_m2", "area_m2", 2), ("force_sum_N", "force_N", 3)):
        true = truth.groupby("frame")[column].sum()
        predicted = (truth[column] * (1 + excess) ** power).groupby(truth["frame"]).sum() / true - 1
        plain = without[name] / true - 1
        # the table was read for single contacts, and the smallest weigh by their own figure: to 40 %
        np.testing.assert_allclose(plain, predicted, rtol=0.4)
        error = with_rim[name] / true - 1
        assert (
            error.abs() < 3 * with_rim[name.replace("_N", "_std_N").replace("_m2", "_std_m2")] / true + 0.01
        ).all()
        assert abs(error.iloc[-1]) < 0.01
        assert error.iloc[-1] < plain.iloc[-1] - 0.5 * predicted.iloc[-1]


def test_adhesion_switched_on_gives_the_forces_of_contacts_that_adhere(tmp_path):
    data = {section: dict(keys) for section, keys in SCENE.items()} | {
        "effects": {"model": "paper", "adhesion": "on"}
    }
    data["elastic"] |= {"work_of_adhesion_J_m2": 0.03}
    scene = scene_from_dict(data)
    write_simulation(scene, need_asperities(scene, "a test"), tmp_path)
    adhering, hertzian = under_other_laws(tmp_path, "adhesion")
    error = adhering["force_sum_N"] - adhering["load_N"]
    assert (error.abs() < 3 * adhering["force_sum_std_N"]).all()
    # Hertz takes no account of the pull, sqrt(8 pi w E* a^3) a contact, and reads that much more
    truth = pd.read_csv(tmp_path / "truth.csv")
    pull = np.sqrt(8 * np.pi * 0.03 * scene.elastic.contact_modulus * truth["radius_m"] ** 3)
    expected = pull.groupby(truth["frame"]).sum()
    found = hertzian["force_sum_N"] - adhering["force_sum_N"]
    np.testing.assert_allclose(found, expected[found.index], rtol=0.03)
    assert (found > 0.1 * hertzian["load_N"]).all()


def test_film_needs_the_radius_of_the_asperities(small_series):
    data = {section: dict(keys) for section, keys in read_scene(small_series).source.items()}
    data |= {"effects": {"film": "on"}}
    del data["asperities"]
    with pytest.raises(InputError, match=r"film = \"on\" needs the radius of the asperities"):
        measure_series(scene_from_dict(data, folder=str(small_series)), workers=1)
    del data["camera"]
    with pytest.raises(InputError, match=r"film = \"on\" needs a section \[camera\]"):
        measure_series(scene_from_dict(data, folder=str(small_series)), workers=1)


def test_sphere_profile_switched_on_gives_the_forces_of_spheres(tmp_path):
    scene, truth = simulated(tmp_path / "sphere", {"sphere_profile": "on"})
    sites = contact_sites(need_asperities(scene, "a test"), scene)["radius_m"].to_numpy()
    true = hertz.load(
        truth["radius_m"].to_numpy(),
        sphere_radius=sites[truth["asperity"].to_numpy(int)],
        contact_modulus=scene.elastic.contact_modulus,
    )
    share = pd.Series(true).groupby(truth["frame"]).sum() / truth.groupby("frame")["force_N"].sum()
    exact, parabola = under_other_laws(tmp_path / "sphere", "sphere_profile")
    # Hertz misses 2/5 (a/R)^2 of a force and more
    assert share.iloc[-1] < 0.97
    ratio = parabola["force_sum_N"] / exact["force_sum_N"]
    np.testing.assert_allclose(ratio, share, atol=2e-3)
    error = exact["force_sum_N"] - exact["load_N"]
    assert (error.abs() < 3 * exact["force_sum_std_N"]).all()
    # an exponent above 3 widens the uncertainty
    assert (exact["force_sum_std_N"] > parabola["force_sum_std_N"]).all()


def spots(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Frame of three contacts in each half, and reference."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:160, 0:240]
    light = np.full((160, 240), 60.0)
    for cy in (40, 120):
        for cx in (50, 120, 190):
            light += 80.0 / (1 + np.exp(1.5 * (np.hypot(x - cx, y - cy) - 9.5)))
    images = (light + rng.normal(0, 2, light.shape), 60.0 + rng.normal(0, 2, light.shape))
    return tuple(np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in images)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("hidden", [0.5, 0.55])
def test_masked_pixels_say_nothing_of_the_polarity(hidden, sign):
    frame, reference = (image if sign > 0 else 255 - image for image in spots(1))
    masked = np.ma.array(frame, mask=np.zeros(frame.shape, bool))
    masked[: round(hidden * len(frame))] = np.ma.masked
    with pytest.warns(FrameWarning):
        table = measure_frame(masked, reference, pixel_size=1e-6)
    assert len(table) == 3
    assert (table["y_px"] > 100).all()
    holes = np.where(masked.mask, np.nan, frame)
    with pytest.warns(FrameWarning):
        other = measure_frame(holes, reference, pixel_size=1e-6)
    # a masked image of integers tells its full scale, one of floats does not
    np.testing.assert_allclose(table["radius_px"], other["radius_px"], rtol=1e-4)


@pytest.mark.parametrize("kind", [">u2", ">f4", "<f8"])
def test_pixels_of_any_byte_order_and_of_a_table_are_measured_alike(kind):
    frame, reference = spots(2)
    plain = measure_frame(frame.astype(np.dtype(kind).newbyteorder("=")), reference, pixel_size=1e-6)
    for image in (frame.astype(kind), pd.DataFrame(frame.astype(np.dtype(kind).newbyteorder("=")))):
        pd.testing.assert_frame_equal(measure_frame(image, reference, pixel_size=1e-6), plain)
    assert len(plain) == 6
