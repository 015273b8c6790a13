"""The background of a series, pooled from its frames: what it gains, and when it is used."""

import shutil
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from small_series import copy_of, write_small_series

from contactimg.files import (
    FrameSource,
    PartStore,
    open_experiment,
    provenance,
    read_scene,
    write_frame,
)
from contactimg.frame import Frame
from contactimg.imaging.fit.disks import render_disks
from contactimg.pipeline import frame as frame_module
from contactimg.pipeline import pooled_background as background_module
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.series import measure_parts, measure_series
from contactimg.scene import scene_from_dict

SHAPE = (300, 320)


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pooled") / "series"
    loads = [0.004, 0.008, 0.015, 0.025, 0.04, 0.06, 0.09]
    return write_small_series(folder, loads_N=loads, shape=list(SHAPE), seed=23)


def measured(folder, **images):
    data = {section: dict(keys) for section, keys in read_scene(folder).source.items()}
    named = {key: value for key, value in (data["images"] | images).items() if value is not None}
    return measure_series(scene_from_dict(data | {"images": named}, folder=str(folder)), workers=1)


@pytest.fixture(scope="module")
def single(series):
    return measured(series, background="reference")


@pytest.fixture(scope="module")
def pooled(series):
    return measured(series)


def errors(run, folder):
    """Error over stated uncertainty, and error, of the contacts inside the field."""
    truth, rows = pd.read_csv(folder / "truth.csv"), []
    for name, part in run.contacts.groupby("frame"):
        there = truth[truth["frame"] == name]
        gap = np.hypot(*(part[k].to_numpy()[:, None] - there[k].to_numpy() for k in ("x_px", "y_px")))
        near, inside = gap.argmin(axis=1), gap.min(axis=1) < 1.0
        for axis, size in (("x_px", SHAPE[1]), ("y_px", SHAPE[0])):
            inside &= (part[axis] > 10) & (part[axis] < size - 11)
        error = part["radius_px"].to_numpy() - there["radius_px"].to_numpy()[near]
        # what the frame does not show of its edge, common to all contacts, is no scatter of theirs
        own = np.sqrt(part["radius_std_px"] ** 2 - part["edge_shift_px"] ** 2)
        rows.append(np.column_stack([error, own])[inside])
    error, std = np.concatenate(rows).T
    return error, error / std


def test_series_of_five_frames_gains_by_pooling(series, single, pooled):
    assert pooled.frames["noise"].median() < 0.98 * single.frames["noise"].median()
    assert pooled.frames["message"].str.contains("background pooled from 7 images: noise").all()
    before, after = errors(single, series)[0], errors(pooled, series)[0]
    # one view among eight instead of one of one: the background's share of the variance, about a half, falls
    # to about a fifth of it for contacts that grow; 200 radii give the ratio of the RMS to 7 %
    assert len(after) > 100
    assert np.sqrt(np.mean(after**2)) < 0.9 * np.sqrt(np.mean(before**2))


def test_stated_uncertainty_falls_with_the_error(series, pooled):
    pull = np.abs(errors(pooled, series)[1])
    # binomial: 3 standard deviations of a fraction of 0.68 of 200
    assert 0.58 < np.mean(pull < 1) < 0.8
    assert np.mean(pull < 2) > 0.9


def test_reference_can_be_asked_for_and_short_series_keep_it(series, single):
    assert not single.frames["message"].str.contains("pooled").any()
    names = [f"frame_{k}.tif" for k in (1, 2, 3, 4)]
    assert not measured(series, frames=names).frames["message"].str.contains("pooled").any()
    asked = measured(series, frames=names, background="pooled")
    assert asked.frames["message"].str.contains("pooled from 4 images").all()


def test_without_reference_the_frames_give_it(series, single):
    alone = measured(series, reference=None, background="reference")
    pooled = measured(series, reference=None)
    assert pooled.frames["message"].str.contains("in the coordinates of frame_").all()
    before, after = (np.sqrt(np.mean(errors(run, series)[0] ** 2)) for run in (alone, pooled))
    assert after < 0.6 * before
    assert after < 1.1 * np.sqrt(np.mean(errors(single, series)[0] ** 2))


def test_reference_in_contact_is_seen_through(series, pooled, tmp_path):
    folder = copy_of(series, tmp_path / "ghosts")
    truth = pd.read_csv(folder / "truth.csv").query("frame == 'frame_5.tif' and radius_px > 3").iloc[::2]
    image = FrameSource("reference.tif", folder / "reference.tif").read().image
    disks = np.column_stack([truth[["x_px", "y_px", "radius_px"]], np.full(len(truth), 1.25)])
    ghosts = image * (1 + render_disks(disks, 1.43, SHAPE))
    write_frame(Frame(np.clip(np.rint(ghosts), 0, 255).astype(np.uint8)), folder / "reference.tif")
    run = measured(folder)
    assert run.frames["message"].str.contains("spots like contacts: not used").all()
    assert run.contacts["area_m2"].sum() == pytest.approx(pooled.contacts["area_m2"].sum(), rel=0.005)


@pytest.mark.parametrize("frame", ["frame_5.tif", "frame_1.tif"])
def test_a_frame_that_is_the_reference_in_contact_is_measured_without_it(frame, series, pooled, tmp_path):
    # the contacts of the first frame, of the least load, are in all others, too
    folder = copy_of(series, tmp_path / "same")
    shutil.copy(folder / frame, folder / "reference.tif")
    run = measured(folder)
    assert (run.frames["status"] == "ok").all()
    assert run.contacts["area_m2"].sum() == pytest.approx(pooled.contacts["area_m2"].sum(), rel=0.005)


def test_a_short_series_is_measured_without_a_reference_in_contact(series, pooled, tmp_path):
    folder = copy_of(series, tmp_path / "short")
    shutil.copy(folder / "frame_1.tif", folder / "reference.tif")
    run = measured(folder, frames=["frame_4.tif"])
    assert run.frames["message"].str.contains("spots like contacts: not used").all()
    true, (found,) = pooled.frames.set_index("frame").loc["frame_4.tif"], run.frames.to_dict("records")
    assert abs(found["area_m2"] - true["area_m2"]) < 3 * found["area_std_m2"]
    asked = measured(folder, frames=["frame_4.tif"], background="reference").frames
    assert not asked["message"].str.contains("not used").any()
    assert abs(asked["area_m2"].iloc[0] - true["area_m2"]) > 3 * true["area_std_m2"]


def test_bad_and_copied_frames_do_no_harm(series, pooled, tmp_path):
    folder = copy_of(series, tmp_path / "bad")
    write_frame(Frame(np.zeros(SHAPE, np.uint8)), folder / "frame_2.tif")
    shutil.copy(folder / "frame_5.tif", folder / "frame_6.tif")
    run = measured(folder)
    assert run.frames["status"].tolist()[1] == "black"
    # of the reference and five different frames one is left out: the copy is measured as its original is
    assert run.frames["message"].str.contains("pooled from 5 images").sum() == 6
    same = [run.contacts.query(f"frame == 'frame_{k}.tif'")["radius_px"].to_numpy() for k in (5, 6)]
    np.testing.assert_array_equal(*same)
    good = [f"frame_{k}.tif" for k in (1, 3, 4, 5, 7)]
    areas = [part.frames.set_index("frame")["area_m2"][good] for part in (run, pooled)]
    np.testing.assert_allclose(*areas, rtol=0.01)


def test_several_references_are_one_with_less_noise(series, tmp_path):
    folder = copy_of(series, tmp_path / "several")
    image = FrameSource("reference.tif", folder / "reference.tif").read().image.astype(float)
    for k in range(3):
        noisy = np.random.default_rng(k).normal(image, 2.0)
        write_frame(Frame(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)), folder / f"empty_{k}.tif")
    data = read_scene(folder).source | {"images": {"reference": "empty_*.tif", "frames": "frame_*.tif"}}
    mean = read_reference(open_experiment(scene_from_dict(data, folder=str(folder))))
    assert mean.dtype == np.float32
    error = (mean - image)[8:-8, 8:-8]
    # rounding adds 1/12 to the variance of 4; the mean of three has a third of it
    assert np.std(error) == pytest.approx(np.sqrt((4 + 1 / 12) / 3), rel=0.1)


def test_measured_again_on_the_pooled_background_only_where_something_changed(series, pooled, tmp_path):
    experiment = open_experiment(read_scene(series))
    record = provenance(command="contactimg process", scene=experiment.scene, inputs=experiment.inputs)
    calls, measure = [], background_module.measure_scene_frame

    def counting(frame, *arguments, **options):
        calls.append(frame.name)
        return measure(frame, *arguments, **options)

    runs = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(background_module, "measure_scene_frame", counting)
        for _ in range(2):
            store = PartStore(tmp_path / "store", record, resumes=False)
            runs.append(measure_parts(experiment, store=store).run)
            calls.append("end")
    assert calls.index("end") >= 7
    assert calls[calls.index("end") :] == ["end", "end"]
    for run in runs:
        pd.testing.assert_frame_equal(run.contacts, pooled.contacts, check_exact=True)
        pd.testing.assert_frame_equal(run.frames, pooled.frames, check_exact=True)


def test_a_frame_that_fails_on_the_pooled_background_keeps_its_measurement(
    series, pooled, monkeypatch, caplog
):
    measure = background_module.measure_on_pool

    def failing(frame, *arguments, **options):
        if frame.name == "frame_3.tif":
            raise MemoryError
        return measure(frame, *arguments, **options)

    monkeypatch.setattr(background_module, "measure_on_pool", failing)
    with caplog.at_level("WARNING"):
        frames = measured(series).frames.set_index("frame")
    assert "frame_3.tif: cannot be measured (MemoryError: ); its measurement before is kept" in caplog.text
    assert (frames["status"] == "ok").all()
    on_pool = frames["message"].str.contains("background pooled")
    assert on_pool.index[~on_pool].tolist() == ["frame_3.tif"]
    whole = pooled.frames.set_index("frame")["area_m2"]
    np.testing.assert_allclose(frames["area_m2"], whole, rtol=0.01)


def test_of_a_long_series_only_the_frames_of_the_pool_are_measured_twice(tmp_path, monkeypatch):
    loads = np.linspace(0.02, 0.06, 20).tolist()
    folder = write_small_series(tmp_path / "long", loads_N=loads, shape=list(SHAPE), seed=24)
    # one frame out of focus: it is measured once more, with optics of its own
    source = FrameSource("frame_02.tif", folder / "frame_02.tif")
    rng = np.random.default_rng(1)
    soft = cv2.GaussianBlur(source.read().image.astype(float), (0, 0), 2.0) + rng.normal(0, 1.5, SHAPE)
    write_frame(Frame(np.clip(np.rint(soft), 0, 255).astype(np.uint8)), source.path)
    names, measure = [], frame_module.measure_prepared

    def counting(frame, *arguments, **options):
        names.append(frame.name)
        return measure(frame, *arguments, **options)

    monkeypatch.setattr(frame_module, "measure_prepared", counting)
    run = measured(folder)
    assert len(names) == 16 + 20
    refused = run.frames["frame"][run.frames["message"].str.contains("which were not used")]
    assert refused.tolist() == ["frame_02.tif"]
    message = run.frames["message"]
    assert message.str.contains("background pooled from 1[67] images").all()
    assert message.str.contains("noise").sum() == 16
    # those that were measured once are as good: 3 standard deviations of a fraction of 0.95 of 200
    once = set(run.frames["frame"][~message.str.contains("noise")])
    for frames in (once, set(run.frames["frame"]) - once):
        part = run.contacts[run.contacts["frame"].isin(frames)]
        error, pull = errors(SimpleNamespace(contacts=part), folder)
        assert len(error) > 100
        assert np.mean(np.abs(pull) < 2) > 0.92
