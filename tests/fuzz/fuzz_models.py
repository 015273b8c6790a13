"""Throw random problems at every contact model and count what comes back.

    python tests/fuzz/fuzz_models.py --count 3000 --seed 7

Case ``k`` depends on the seed and on ``k`` alone; ``--only k`` repeats one. Exit code 1 if a case fails: an
exception that is not one of contactimg's own, no answer within the time limit, or a solution with the status
"converged" whose forces do not sum to the load or are not finite.
"""

import argparse
import multiprocessing
import resource
import signal
import sys
import time
import warnings
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from model_cases import draw_case, verdict

MEMORY = 8 * 2**30
"""Bytes of address space of a worker: a case that asks for more fails instead of filling the machine."""


def case_of(seed: int, number: int) -> object:
    """Case ``number`` of a seed."""
    return draw_case(np.random.default_rng([seed, number]))


def work(pipe: Connection, seed: int, limit: float) -> None:
    """Answer numbers of cases with verdicts until None comes."""
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    while (number := pipe.recv()) is not None:
        case = case_of(seed, number)
        start = time.process_time()
        # the kernel ends the process after this processor time, which a busy machine does not use up
        resource.setrlimit(resource.RLIMIT_CPU, (int(start + limit) + 1, resource.RLIM_INFINITY))
        pipe.send((case.model, *verdict(case), time.process_time() - start))


class Worker:
    """A process that can be killed when a case takes too long."""

    def __init__(self, seed: int, limit: float) -> None:
        self.limit = limit
        self.pipe, other = multiprocessing.Pipe()
        self.process = multiprocessing.Process(target=work, args=(other, seed, limit), daemon=True)
        self.process.start()

    def solve(self, number: int) -> tuple[str, str, str, float]:
        """Model, outcome, reason and time of a case."""
        self.pipe.send(number)
        try:
            if self.pipe.poll(20 * self.limit):
                return self.pipe.recv()
            why = f"no answer in {20 * self.limit:g} s of real time"
        except (EOFError, ConnectionError):
            self.process.join(10)
            slow = self.process.exitcode == -signal.SIGXCPU
            why = f"no answer in {self.limit:g} s of processor time" if slow else "the process died"
        self.process.kill()
        self.process.join()
        return "?", "FAULT", why, self.limit


def main() -> int:
    """Run the cases and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--only", type=int, help="number of a single case, run in this process")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of processor time a case may take")
    parser.add_argument("--refused", action="store_true", help="print the reasons of refusal")
    options = parser.parse_args()
    if options.only is not None:
        case = case_of(options.seed, options.only)
        print(case, case.table, *verdict(case), sep="\n")
        return 0
    counts: Counter[tuple[str, str]] = Counter()
    reasons: Counter[str] = Counter()
    worker, slowest = Worker(options.seed, options.limit), 0.0
    for number in range(options.count):
        model, outcome, why, seconds = worker.solve(number)
        slowest = max(slowest, seconds)
        if not worker.process.is_alive():
            worker = Worker(options.seed, options.limit)
            model = case_of(options.seed, number).model
        counts[model, outcome] += 1
        if outcome == "FAULT":
            print(f"case {number} ({model}): {why}", flush=True)
        elif why:
            reasons[f"{model}: {outcome}: {why[:110]}"] += 1
    for (model, outcome), count in sorted(counts.items()):
        print(f"{model:14s} {outcome:10s} {count:6d}")
    if options.refused:
        print(*(f"{count:5d} {reason}" for reason, count in reasons.most_common()), sep="\n")
    faults = sum(count for (_, outcome), count in counts.items() if outcome == "FAULT")
    print(f"{options.count} cases of seed {options.seed}: {faults} faults; the slowest took {slowest:.1f} s")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
