"""Read mutated files of every kind and count what comes back (POSIX).

    python tests/fuzz/fuzz_files.py --count 5000 --seed 7

Case ``k`` depends on the seed and on ``k`` alone; ``--only k`` repeats one with its traceback. Each case runs
in a process of its own with limits of memory and processor time. Exit code 1 if a case fails: an exception
other than contactimg's own, no answer within the time limit, or more memory than a few times what the
file can need.
"""

import argparse
import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from file_cases import KINDS, Samples, make_samples, run_case

from contactimg.errors import ContactimgError
from contactimg.files import decoders

PIXELS = 4_000_000
"""Largest image, px: 32 MB in double precision, so that a lie about the size shows within `MEMORY`."""

MEMORY = 2**29
"""Bytes that a case may take beyond what the process has at its start."""


def outcome(kind: str, samples: Samples, work: Path, rng: random.Random) -> str:
    """Read, refused, or ``FAULT: why``."""
    try:
        return run_case(kind, samples, work, rng)
    except ContactimgError:
        return "refused"
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        last = next((frame for frame in reversed(frames) if "/contactimg/" in frame.filename), frames[-1])
        place = f"{Path(last.filename).name}:{last.lineno}"
        return f"FAULT: {type(error).__name__} at {place}: {str(error)[:160]}"


def in_a_child(number: int, seed: int, kind: str, samples: Samples, limit: float) -> str:
    """The outcome of a case in a process of its own."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        _limit(limit)
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, 2)
        with tempfile.TemporaryDirectory(prefix="fuzz_case_") as work:
            text = outcome(kind, samples, Path(work), generator(seed, number))
        os.write(writer, text.encode()[:4000])
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        text = pipe.read().decode(errors="replace")
    status = os.waitpid(child, 0)[1]
    return text or f"FAULT: the process ended with {os.waitstatus_to_exitcode(status)}"


def _limit(seconds: float) -> None:
    """Limit the memory and the processor time of this process."""
    warnings.simplefilter("ignore")
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    used = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(used + seconds) + 1, resource.RLIM_INFINITY))


def generator(seed: int, number: int) -> random.Random:
    """The random numbers of a case."""
    return random.Random(f"{seed} {number}")  # noqa: S311


def kind_of(number: int, kinds: list[str]) -> str:
    """The kind of a case."""
    return kinds[number % len(kinds)]


def main() -> int:
    """Run the cases and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--kind", action="append", choices=KINDS, help="only this kind; repeat for more")
    parser.add_argument("--only", type=int, help="number of a single case, run in this process")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of processor time a case may take")
    options = parser.parse_args()
    decoders.MAX_PIXELS = PIXELS
    kinds = options.kind or list(KINDS)
    top = Path(tempfile.mkdtemp(prefix="fuzz_files_"))
    try:
        samples = make_samples(top)
        if options.only is not None:
            (top / "work").mkdir()
            kind = kind_of(options.only, kinds)
            print(kind, run_case(kind, samples, top / "work", generator(options.seed, options.only)))
            return 0
        return _run_all(options, kinds, samples)
    finally:
        shutil.rmtree(top, ignore_errors=True)


def _run_all(options: argparse.Namespace, kinds: list[str], samples: Samples) -> int:
    """Run the cases and print the counts; 1 if one failed."""
    counts: Counter[tuple[str, str]] = Counter()
    slowest = 0.0
    for number in range(options.count):
        kind, start = kind_of(number, kinds), time.monotonic()
        text = in_a_child(number, options.seed, kind, samples, options.limit)
        slowest = max(slowest, time.monotonic() - start)
        counts[kind, text.partition(":")[0]] += 1
        if text.startswith("FAULT"):
            print(f"case {number} ({kind}): {text}", flush=True)
    for (kind, text), count in sorted(counts.items()):
        print(f"{kind:8s} {text:8s} {count:6d}")
    faults = sum(count for (_, text), count in counts.items() if text == "FAULT")
    print(f"{options.count} cases of seed {options.seed}: {faults} faults; the slowest took {slowest:.1f} s")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
