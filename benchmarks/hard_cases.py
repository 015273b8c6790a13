"""Write docs/hard_cases.md: every hard case of the contact models and what became of it.

python benchmarks/run.py hard_cases.page
"""

import re
from collections.abc import Sequence

import pandas as pd
from hard_problems import ALL_CASES
from shared import ROOT, markdown

from contactimg.models.convergence import CONVERGED
from contactimg.models.hard_cases import run_cases

PAGE = ROOT / "docs" / "hard_cases.md"
HEAD = """# Hard cases

`contactimg selftest` solves numerically hard contact problems whose answers are known from elsewhere, in some
ten seconds; its exit code is 1 if one does not hold. From Python: `contactimg.models.hard_cases.run_cases()`.
The tests solve all cases of this page, which `python benchmarks/run.py hard_cases.page` writes.

`error`: the largest relative difference from the truth, or what is said where there is no solution.
`allowed`: what rounding, the sums, or a known error of the [model](models.md) account for. Cases that differ
in numbers alone share a row.

"""
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def page() -> None:
    """Run every case and write the page."""
    write(run_cases(ALL_CASES))


def write(table: pd.DataFrame) -> None:
    """Write the page from the table of the cases."""
    kinds = [NUMBER.sub("#", case + truth) for case, truth in zip(table["case"], table["truth"], strict=True)]
    same = table.assign(kind=kinds, solved=table["said"] == CONVERGED)
    rows = [row(part) for _, part in same.groupby(["kind", "solved", "allowed"])]
    text = markdown(["case", "error", "allowed", "truth"], rows)
    holding = f"{int(table['passed'].sum())} of {len(table)} hold."
    residual = f"The solvers meet their own equations within {table['residual'].max():.2g} of the load."
    PAGE.write_text(f"{HEAD}{text}\n\n{holding} {residual}\n", encoding="utf-8")


def row(cases: pd.DataFrame) -> list[str]:
    """Case, error, allowed error and truth of cases that differ in numbers alone."""
    error, allowed = (f"{cases[name].max():.2g}".replace("nan", "") for name in ("error", "allowed"))
    if not cases["solved"].all():
        error, allowed = "; ".join(cases["said"]), ""
    fails = "" if cases["passed"].all() else "FAILS: "
    return [ranges(cases["case"].tolist()), fails + error, allowed, ranges(cases["truth"].tolist()) or "none"]


def ranges(texts: Sequence[str]) -> str:
    """Texts that differ in numbers alone as one, with the range of each number."""
    numbers = zip(*map(NUMBER.findall, texts), strict=True)
    ends = [dict.fromkeys((min(one, key=float), max(one, key=float))) for one in numbers]
    parts = iter([" to ".join(low_and_high) for low_and_high in ends])
    return NUMBER.sub(lambda _number: next(parts), texts[0])
