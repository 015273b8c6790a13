"""Mutated files of every kind that contactimg reads, and what reading them gives."""

import io
import json
import random
import shutil
import struct
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tifffile
import tomli_w
from PIL import Image

from contactimg.cli import main
from contactimg.errors import ContactimgError
from contactimg.files import (
    list_frames,
    open_experiment,
    read_asperities,
    read_calibration,
    read_loads,
    read_scene,
)
from contactimg.pipeline.inputs import scene_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict

KINDS = ("tiff", "still", "seq", "video", "scene", "table", "run")
NO_MEMORY = "does not fit into memory"

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0004, 0.0003]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.0008, "seed": 3},
    "camera": {"pixel_size_m": 6.0e-6},
    "images": {"reference": "reference.tif", "frames": "frame_*.tif", "loads": "loads.csv"},
    "measure": {"method": "threshold", "threshold": 0.5},
    "simulate": {"loads_N": [0.004, 0.008], "shape": [90, 120], "electrons_per_level": 20, "seed": 7},
}
SLIPS = [
    0,
    -1,
    1e300,
    -1e-300,
    1e9,
    1e-9,
    "",
    "x",
    True,
    None,
    [],
    {},
    [1],
    [1, 2],
    "NaN",
    float("nan"),
    float("inf"),
]
CELLS = [
    "",
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e400",
    "1e-400",
    "x",
    "1,5",
    "9" * 400,
    "1_0",
    "\x00",
    "ÿ",
    '"',
    "\n",
]


@dataclass(frozen=True)
class Samples:
    """Sound files to mutate: a folder of images, one of a simulated series, and one of a run."""

    images: Path
    series: Path
    run: Path


def make_samples(top: Path) -> Samples:
    """Write the sound files."""
    images, series, run = (top / name for name in ("images", "series", "run"))
    images.mkdir(parents=True)
    _write_images(images)
    series.mkdir()
    scene = scene_from_dict(SCENE)
    write_simulation(scene, scene_asperities(scene), series)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        code = main(["process", str(series), "-o", str(run), "--workers", "1", "--quiet", "--no-pictures"])
    if code != 0:
        raise RuntimeError(f"the sound run ended with {code}")
    return Samples(images, series, run)


def _write_images(folder: Path) -> None:
    """A file of every format."""
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 255, (40, 60), np.uint8)
    deep, colour = grey.astype(np.uint16) * 16, np.stack([grey] * 3, axis=-1)
    tifffile.imwrite(folder / "plain.tif", deep, metadata=None)
    tifffile.imwrite(folder / "float.tif", deep.astype(np.float32), metadata=None)
    tifffile.imwrite(folder / "stack.tif", np.stack([deep] * 3), imagej=True)
    tifffile.imwrite(folder / "big.tif", grey, bigtiff=True)
    for name, options in {
        "zlib.tif": {"compression": "zlib", "predictor": True},
        "tiled.tif": {"compression": "zlib", "tile": (16, 16)},
        "lzw.tif": {"compression": "lzw"},
        "bits.tif": {"compression": "packbits", "rowsperstrip": 8},
        "colour.tif": {},
    }.items():
        tifffile.imwrite(folder / name, colour if name == "colour.tif" else grey, metadata=None, **options)
    for name, array in {"a.png": deep, "b.png": colour, "c.bmp": grey, "d.jpg": grey}.items():
        Image.fromarray(array).save(folder / name)
    header = struct.pack(
        "<L24sll512s9Ld8L",
        0xFEED,
        b"Norpix",
        5,
        1024,
        b"",
        *(60, 40, 8, 8, 2400, 100, 3, 0, 2408),
        25.0,
        *[0] * 8,
    )
    (folder / "e.seq").write_bytes(header.ljust(8192, b"\0") + (grey.tobytes() + b"\0" * 8) * 3)
    video = cv2.VideoWriter(str(folder / "f.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (60, 40))
    for _ in range(3):
        video.write(colour)
    video.release()


SUFFIXES = {"tiff": (".tif",), "still": (".png", ".bmp", ".jpg"), "seq": (".seq",), "video": (".avi",)}


def spoil_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes with numbers overwritten, bits turned, parts cut out, doubled or zeroed, or the end cut off."""
    spoilt = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        if not spoilt:
            break
        near = min(len(spoilt), rng.choice([64, 600, len(spoilt)]))
        place, length = rng.randrange(near), rng.choice([1, 2, 4, 8, 64, 1000])
        match rng.randrange(7):
            case 0 | 1:
                size = rng.choice([1, 2, 4, 8])
                number = rng.choice(
                    [0, 1, -1, 2**7, 2**15, 2**24, 2**31 - 1, 60000, 100_000, rng.getrandbits(63)]
                )
                order = rng.choice(["little", "big"])
                spoilt[place : place + size] = (number % 2 ** (8 * size)).to_bytes(size, order)
            case 2:
                spoilt[place] ^= 1 << rng.randrange(8)
            case 3:
                del spoilt[place : place + length]
            case 4:
                spoilt[place:place] = spoilt[place : place + length]
            case 5:
                spoilt[place : place + length] = bytes(min(length, len(spoilt) - place))
            case 6:
                del spoilt[rng.randrange(len(spoilt)) :]
    return bytes(spoilt)


def spoil_text(text: str, rng: random.Random, separator: str = ",") -> bytes:
    """A table with cells, lines or columns changed, or bytes spoilt."""
    lines = text.splitlines()
    for _ in range(rng.choice([1, 1, 2, 5])):
        if not lines:
            break
        row = rng.randrange(len(lines))
        cells = lines[row].split(separator)
        match rng.randrange(7):
            case 0 | 1 | 2:
                cells[rng.randrange(len(cells))] = rng.choice(CELLS)
                lines[row] = separator.join(cells)
            case 3:
                del lines[row]
            case 4:
                lines.append(lines[row])
            case 5:
                rng.shuffle(cells)
                lines[row] = separator.join(cells)
            case 6:
                return spoil_bytes("\n".join(lines).encode("utf-8", "surrogateescape"), rng)
    return ("\n".join(lines) + "\n").encode("utf-8", "surrogateescape")


def spoil_data(data: object, rng: random.Random) -> object:
    """Nested dicts and lists with one value, key or item changed."""
    holder, key = _place(data, rng)
    if holder is None:
        return rng.choice(SLIPS)
    match rng.randrange(4):
        case 0 | 1:
            holder[key] = rng.choice(SLIPS)
        case 2:
            number = isinstance(holder[key], int | float)
            holder[key] = holder[key] * rng.choice([1e3, 1e-3, -1, 1e6]) if number else rng.choice(SLIPS)
        case 3:
            del holder[key]
    return data


def _place(data: object, rng: random.Random) -> tuple[object, object]:
    """A place in nested dicts and lists, as holder and key; each level is as likely as the next."""
    holder, key, here = None, None, data
    while isinstance(here, dict | list) and here and (holder is None or rng.random() < 0.6):
        holder = here
        key = rng.choice(list(here) if isinstance(here, dict) else range(len(here)))
        here = here[key]
    return holder, key


def run_case(kind: str, samples: Samples, work: Path, rng: random.Random) -> str:
    """What a case gives: ``read`` or ``refused``; an exception if something is wrong."""
    if kind in SUFFIXES:
        return _image_case(kind, samples, work, rng)
    return {"scene": _scene_case, "table": _table_case, "run": _run_case}[kind](samples, work, rng)


def _image_case(kind: str, samples: Samples, work: Path, rng: random.Random) -> str:
    """Read a spoilt image file."""
    files = sorted(path for path in samples.images.iterdir() if path.suffix in SUFFIXES[kind])
    file = rng.choice(files)
    target = work / file.name
    target.write_bytes(spoil_bytes(file.read_bytes(), rng))
    sources = list_frames(target)
    assert len(sources) < 100_000, f"{len(sources)} frames in {target.stat().st_size} bytes"
    outcome = "refused"
    for source in sources[:4]:
        try:
            frame = source.read()
        except ContactimgError as error:
            _check_sentence(str(error))
        else:
            assert frame.image.ndim == 2
            outcome = "read"
    return outcome


def _check_sentence(text: str) -> None:
    """Raise unless a message is one short sentence."""
    assert text.strip(), "no message"
    assert "Traceback" not in text, text
    assert NO_MEMORY not in text, text
    assert len(text) < 2000, f"{len(text)} characters"


def _scene_case(samples: Samples, work: Path, rng: random.Random) -> str:
    """Read a spoilt scene file."""
    for path in samples.series.iterdir():
        (work / path.name).symlink_to(path)
    (work / "scene.toml").unlink()
    if rng.random() < 0.4:
        data = spoil_bytes(tomli_w.dumps(SCENE).encode(), rng)
    else:
        spoilt = _without_none(spoil_data(json.loads(json.dumps(SCENE)), rng))
        data = tomli_w.dumps(spoilt if isinstance(spoilt, dict) else {}).encode()
    (work / "scene.toml").write_bytes(data)
    try:
        open_experiment(read_scene(work))
    except ContactimgError as error:
        _check_sentence(str(error))
        return "refused"
    return "read"


def _without_none(value: object) -> object:
    """TOML has no null: such keys are left out."""
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value if item is not None] if isinstance(value, list) else value


def _table_case(samples: Samples, work: Path, rng: random.Random) -> str:
    """Read a spoilt table of loads, asperities or a calibration."""
    read, text = rng.choice(
        [
            (read_loads, (samples.series / "loads.csv").read_text()),
            (read_asperities, (samples.series / "asperities.csv").read_text()),
            (read_calibration, '{"threshold": {"value": 0.4, "std": 0.1, "unit": ""}, "method": "disk"}'),
        ]
    )
    (work / "table").write_bytes(spoil_text(text, rng))
    try:
        read(work / "table")
    except ContactimgError as error:
        _check_sentence(str(error))
        return "refused"
    return "read"


def _run_case(samples: Samples, work: Path, rng: random.Random) -> str:
    """Analyse, overlay or report a spoilt run folder."""
    folder = work / "run"
    shutil.copytree(samples.run, folder)
    for _ in range(rng.choice([1, 1, 2])):
        name = rng.choice(["provenance.json", "contacts.csv", "frames.csv", "rejected.csv"])
        _spoil_file(folder / name, rng)
    command = rng.choice(
        [
            ["analyse", str(folder), "-o", str(work / "out"), "--quiet"],
            ["overlay", str(folder), "-o", str(work / "out"), "--workers", "1", "--quiet"],
            ["report", str(folder), "-o", str(work / "report.html"), "--quiet"],
        ]
    )
    said = io.StringIO()
    with redirect_stderr(said), redirect_stdout(io.StringIO()):
        code = main(command)
    assert code in (0, 1, 2), f"exit code {code}"
    if code == 2:
        _check_sentence(said.getvalue())
    return "read" if code < 2 else "refused"


def _spoil_file(path: Path, rng: random.Random) -> None:
    """Change a file of a run, or delete or empty it."""
    if not path.exists():
        return
    chance = rng.random()
    if chance < 0.05:
        path.unlink()
    elif chance < 0.1:
        path.write_bytes(b"")
    elif path.suffix == ".json" and chance < 0.8 and path.read_bytes().startswith(b"{"):
        with suppress(ValueError):
            path.write_text(json.dumps(spoil_data(json.loads(path.read_text()), rng)))
    elif path.suffix == ".csv":
        path.write_bytes(spoil_text(path.read_text(encoding="utf-8", errors="surrogateescape"), rng))
    else:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
