"""Write docs/hard_cases.md: every hard case of the contact models and what became of it.

python benchmarks/run.py hard_cases.page
"""

from hard_problems import ALL_CASES
from shared import ROOT

from contactimg.hard_cases import run_cases

PAGE = ROOT / "docs" / "hard_cases.md"
HEAD = """# Hard cases

Numerically hard contact problems, each beside what is known of its answer from elsewhere: a closed form, a
limit, the equations summed one by one, boundary elements, or the spectral solution of the whole contact
problem. `contactimg selftest` runs some of them in some ten seconds; its exit code is 1 if one does not hold.
The tests run all of them. This page is written by `python benchmarks/run.py hard_cases.page`.

"residual" is what the solver's own equations miss, over the load; "error" the largest relative difference
from the truth; "allowed" what rounding, the sums, or a known error of the model (`docs/models.md`) account
for.

| case | answer | residual | error | allowed | truth |
|---|---|---|---|---|---|
"""


def page() -> None:
    """Run every case and write the page."""
    table = run_cases(ALL_CASES)
    rows = [
        f"| {row.case} | {'' if row.passed else 'FAILS: '}{row.said} | {row.residual:.2g} | "
        f"{row.error:.2g} | {row.allowed:.2g} | {row.truth or 'none'} |".replace("nan", "")
        for row in table.itertuples()
    ]
    holding = f"\n{int(table['passed'].sum())} of {len(table)} hold.\n"
    PAGE.write_text(HEAD + "\n".join(rows) + "\n" + holding, encoding="utf-8")
