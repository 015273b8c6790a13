"""Run the commands that README, tutorial and how-to pages show, and compare the output that is printed there.

    python benchmarks/run.py documented_commands.compare
    python benchmarks/run.py documented_commands.compare --write    # output and figures of today on the pages

Each line of code that begins with `contactimg` is run, in the order of the pages, in one copy of sample_data.
In a block `console` it begins with `$ `, and what it prints stands below, with `...` for lines left out. A
block `toml` whose first line is a comment that names a file is written to that file. Numbers agree within one
of their last printed digit, whole numbers exactly; times are not compared.
"""

import contextlib
import io
import re
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from glob import glob
from itertools import takewhile
from pathlib import Path
from unittest import mock

import numpy as np
from PIL import Image

from contactimg.cli import main as contactimg

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/tutorial.md", "docs/effects.md", "docs/tradeoff.md", "docs/howto/*.md")

NOT_RUN = ("--cluster", "contactimg review", ".sur")
"""What a command says that needs a cluster, a person, or a file of an instrument."""

SHORTENED = {
    "contactimg process": " --no-pictures --workers 1",
    "contactimg analyse my_frames": " --no-models",
    "contactimg analyse runs": " --no-models",
    "contactimg tradeoff": " --knob model",
    "contactimg calibrate jkr": " --frames frame_0[1-3].tif",
    "contactimg calibrate threshold": " --frames frame_[1-2].tif",
    "contactimg calibrate plateau": " --frames frame_1.tif",
}
"""Slow commands without shown output -> what is added to them where output is compared."""

FIGURES = {
    "overlay": "results/compared/overlays/frame_6.tif",
    "tutorial_area": "results/analysis/area",
    "tutorial_profile": "results/analysis/profile_6",
    "calibration_jkr": "jkr/jkr",
    "calibration_threshold": "threshold/slope_threshold",
    "calibration_plateau": "plateau/plateau",
}
"""Figure of the pages -> the file that a command writes, both without `.png`."""
WIDEST_PX = 1600

COMMAND = re.compile(r"^(?: {4})?(?:\$ )?(contactimg [a-z].*)")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$|^( {4}\S[^\n]*\n)", re.MULTILINE | re.DOTALL)
TIME = re.compile(r"\d[\d.e+]* (?:min|ms|µs|s|x)(?![\w/])")
NUMBER = re.compile(r"([(±] ?)?(?<![\w.])([-+]?\d+(?:\.(\d+))?(?:e([-+]?\d+))?)")


def prepare(folder: Path) -> None:
    """Make the folders that the pages speak of: sample_data, and `my_frames` and others from it.

    Of the places, whose output no page shows, two are enough.
    """
    data, mine = folder / "sample_data", folder / "my_frames"
    left_out = shutil.ignore_patterns("contactimg_out", "__pycache__", "place_3", "place_4")
    shutil.copytree(ROOT / "sample_data", data, ignore=left_out)
    mine.mkdir()
    for name in ("frame_1.tif", "frame_2.tif", "frame_3.tif", "asperities.csv"):
        shutil.copy(data / "sa_plus" / name, mine)
    (mine / "loads.csv").write_text("frame,load_N\nframe_1.tif,0.02\nframe_2.tif,0.05\nframe_3.tif,0.1\n")
    shutil.copy(data / "sa_plus/reference.tif", mine / "no_contact.tif")
    for name in ("dry", "wet", "oiled"):
        (folder / name).mkdir()
        for file, new in (("frame_3.tif", "frame_3.tif"), ("reference.tif", "no_contact.tif")):
            shutil.copy(data / "sa_plus_places/place_1" / file, folder / name / new)
    (folder / "lens_7.toml").write_text("[indenter]\nradius_m = 0.1288\n[camera]\npixel_size_m = 8e-6\n")
    y, x = np.mgrid[-100:100, -100:100] * 0.5
    np.save(folder / "map.npy", np.maximum(np.sqrt(100**2 - x**2 - y**2) - 90, 0))


@cache
def run(command: str) -> str:
    """What a command prints on standard output; it must end well. The same command is run once."""
    words = shlex.split(command, comments=True)[1:]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = contactimg([file for word in words for file in sorted(glob(word)) or [word]])  # noqa: PTH207
    if code:
        raise RuntimeError(f"`{command}` ends with {code}:\n{out.getvalue()}{err.getvalue()}")
    return out.getvalue()


def stale(shown: list[str], printed: list[str]) -> list[str]:
    """Lines of a page that a command no longer prints in this order, or what it prints besides."""
    before = list(takewhile(lambda line: line != "...", shown))
    after = shown[len(before) + 1 :]
    found = [*printed[: len(before)], "...", *printed[len(printed) - len(after) :]] if after else printed
    wrong = [f"- {a}\n+ {b}" for a, b in zip(shown, found, strict=False) if not same(a, b)]
    return (
        wrong + [f"- {line}" for line in shown[len(found) :]] + [f"+ {line}" for line in found[len(shown) :]]
    )


def same(shown: str, printed: str) -> bool:
    """Whether two lines differ in nothing but times, spaces and the last digits of their numbers."""
    texts = [re.sub(r"[\s─]+", " ", TIME.sub("TIME", line)).strip() for line in (shown, printed)]
    if len({NUMBER.sub("0", text) for text in texts}) > 1:
        return False
    pairs = zip(*(NUMBER.findall(text) for text in texts), strict=True)
    return all(abs(float(a[1]) - float(b[1])) <= 1.001 * max(digit(*a), digit(*b)) for a, b in pairs)


def digit(bracket: str, number: str, decimals: str, power: str) -> float:
    """One of the last digit of a number; 0 of a whole one, unless it is the uncertainty of another number."""
    whole = "." not in number and not power and not bracket
    return 0.0 if whole else 10.0 ** (int(power or 0) - len(decimals))


def lines_of(text: str) -> list[str]:
    """Lines that are not empty, without spaces at their ends."""
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def commands_of(block: str, *, console: bool) -> Iterator[tuple[str, str]]:
    """Each command of a block of code, and what the page says that it prints."""
    parts = re.split(r"^\$ ", block, flags=re.MULTILINE)[1:] if console else block.splitlines(keepends=True)
    for part in parts:
        first, _, rest = part.partition("\n")
        found = COMMAND.match(first)
        if found:
            yield re.split(r"\s+# ", found[1])[0], rest


def run_page(page: Path, done: dict[str, float], *, write: bool = False) -> list[str]:
    """Run the commands of a page in the working directory; return what it shows and they do not print."""
    text, wrong = page.read_text(encoding="utf-8"), list[str]()
    for match in BLOCK.finditer(text):
        language, block = match[1] or "", match[2] or match[3] or ""
        named = re.match(r"# ([\w/]+\.toml)\n", block)
        if language == "toml" and named:
            Path(named[1]).write_text(block, encoding="utf-8")
        for command, shown in commands_of(block, console=language == "console"):
            if (command in done and not shown.strip()) or any(part in command for part in NOT_RUN):
                continue
            begin = time.process_time()
            try:
                short = [added for slow, added in SHORTENED.items() if command.startswith(slow)]
                printed = run(command + "".join([] if write or shown.strip() else short))
            except RuntimeError as error:
                wrong.append(f"{page.name}: {error}")
                continue
            done[command] = time.process_time() - begin
            if shown.strip():
                differing = stale(lines_of(shown), lines_of(printed))
                wrong += [f"{page.name}: {command}", *differing] if differing else []
                if write:
                    text = text.replace(f"$ {command}\n{shown}", f"$ {command}\n{renewed(shown, printed)}")
    if write:
        page.write_text(text, encoding="utf-8")
    return wrong


def renewed(shown: str, printed: str) -> str:
    """What to show: all, or as many lines before and after a line `...` as are shown now."""
    lines, old = [line.rstrip() for line in printed.strip("\n").splitlines()], shown.rstrip().splitlines()
    if "..." in old:
        before, after = old.index("..."), len(old) - old.index("...") - 1
        lines = [*lines[:before], "...", *lines[len(lines) - after :]]
    return "\n".join(lines) + "\n"


def keep_figure(file: Path, target: Path) -> None:
    """Store a figure as wide as a page needs it."""
    image = Image.open(file)
    if image.width > WIDEST_PX:
        size = (WIDEST_PX, round(image.height * WIDEST_PX / image.width))
        image = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        image = image.quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    image.save(target, optimize=True)


def run_pages(*, write: bool = False) -> tuple[list[str], dict[str, float]]:
    """What the pages show and the commands no longer print; and the seconds that each command takes."""
    wrong, done = list[str](), dict[str, float]()
    formats = ("png", "svg", "pdf") if write else ()  # made, but not written, where not kept
    shown = mock.patch("contactimg.files.figures.FIGURE_FORMATS", formats)
    with shown, tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        prepare(Path(folder))
        for pattern in PAGES:
            for page in sorted(ROOT.glob(pattern)):
                wrong += run_page(page, done, write=write)
        if write:
            for figure, file in FIGURES.items():
                keep_figure(Path(f"{file}.png"), ROOT / f"docs/figures/{figure}.png")
    return wrong, done


def compare(write: bool = False) -> None:  # noqa: FBT001, FBT002 - an option
    """Print how long each command takes, and what differs; then the exit code is 1."""
    wrong, done = run_pages(write=write)
    for command, seconds in done.items():
        print(f"{seconds:6.1f} s  {command}")
    print(f"{sum(done.values()):6.1f} s  in total", *wrong, sep="\n")
    sys.exit(bool(wrong))
