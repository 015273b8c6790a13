"""Frames stored as JPEG files of low quality or as a video: blocks of 8 px of one level each."""

import cv2
import numpy as np
import pytest
from camera_worlds import make_scene
from contact_frames import match

from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.blocks import rounding_of_blocks
from contactimg.tables import Status


def stored(image, quality):
    """What a JPEG file of that quality keeps of an image."""
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)


def f1(truth, disks):
    """Harmonic mean of the share of the contacts found and of that of the finds that are contacts."""
    pairs, required = match(truth, disks), truth["required"].to_numpy(bool)
    found = np.count_nonzero(required[pairs[:, 0]]) / required.sum()
    return 2 * found * (true := len(pairs) / len(disks)) / (found + true)


@pytest.mark.parametrize("quality", [20, 40])
@pytest.mark.parametrize("view", ["bright", "dark", "no reference"])
def test_contacts_of_a_compressed_frame_are_found_and_their_areas_hold(quality, view):
    scene = make_scene("plain", 60, 42)
    images = [(220 - image if view == "dark" else image) for image in (scene.frame, scene.reference)]
    frame, reference = (stored(image, quality) for image in images)
    result = measure_image(frame, None if view == "no reference" else reference)
    assert f1(scene.truth, result.disks) > (0.9 if quality == 20 else 0.95)
    pairs = match(scene.truth, result.disks)
    area, true = (
        result.disks["area_px2"].to_numpy()[pairs[:, 1]],
        scene.truth["area_px2"].to_numpy()[pairs[:, 0]],
    )
    assert area.sum() == pytest.approx(true.sum(), rel=0.03)
    if quality < 50:
        assert result.status != Status.OK  # no disk describes what such a file keeps of one


def test_contacts_in_a_video_that_keeps_unchanged_blocks_are_found(tmp_path):
    """MPEG-4 copies the blocks of a frame that have hardly changed since the reference."""
    scene, path = make_scene("plain", 60, 42), tmp_path / "series.mp4"
    shape = [size - size % 2 for size in scene.frame.shape]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25, shape[::-1])
    for image in 3 * [scene.reference] + 5 * [scene.frame]:
        video.write(cv2.cvtColor(image[: shape[0], : shape[1]], cv2.COLOR_GRAY2BGR))
    video.release()
    stored_video = cv2.VideoCapture(str(path))
    images = [cv2.cvtColor(stored_video.read()[1], cv2.COLOR_BGR2GRAY) for _ in range(8)]
    result = measure_image(images[-1], images[1])
    assert f1(scene.truth, result.disks) > 0.95
    assert measure_image(images[-1]).status != Status.NO_CONTACT


def test_the_rounding_of_blocks_is_measured_on_flat_blocks_that_differ_by_little():
    rng = np.random.default_rng(3)
    noise = rng.normal(90, 2, (240, 320)).round().astype(np.uint8)
    assert rounding_of_blocks(noise, noise) == 0.0
    ramp = np.broadcast_to(np.linspace(60, 120, 320), (240, 320))
    light = (ramp + rng.normal(0, 0.7, ramp.shape)).round().astype(np.uint8)
    # the standard table rounds the mean of a block in steps of 2 grey levels at quality 50, of 4 at 25
    for quality, step in ((50, 2.0), (25, 4.0)):
        for cut in (0, 3):  # a frame cut out of a larger picture has no block at its corner
            assert rounding_of_blocks(stored(light, quality)[cut:, cut:]) == pytest.approx(step / 12**0.5)
    squares = np.where(np.add.outer(np.arange(240) // 16 % 2, np.arange(320) // 16 % 2) == 2, 200, 50)
    assert rounding_of_blocks(squares.astype(np.uint8)) == 0.0  # a contrast, not a rounding
    assert rounding_of_blocks(np.full((240, 320), 7.0)) == rounding_of_blocks(np.zeros((4, 5))) == 0.0


def test_light_that_compression_has_rounded_is_not_taken_for_that_of_contacts():
    """All blocks of a flat background are rounded alike, by more than the faint light about contacts."""
    scene = make_scene("JPEG 20", 140, 32)
    disks = measure_image(scene.frame, scene.reference).disks
    area = (scene.truth.area_px2 * scene.truth.visible).sum()
    assert disks.visible_area_px2.sum() == pytest.approx(area, rel=0.01)
