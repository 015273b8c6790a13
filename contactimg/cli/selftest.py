"""`selftest`: the hard cases of the contact models, on the user's machine."""

from typing import Annotated

from contactimg.cli import options as shared
from contactimg.cli.printing import echo_table, progress, say
from contactimg.timings import stage

LONGEST_SENTENCE = 60
"""Characters of a refusal that the table shows. Chosen: a row stays a line."""


@shared.command()
def selftest(*, every: Annotated[bool, "--all"] = False) -> int:
    """Solve numerically hard contact problems and compare each with what is known of its answer.

    Among them jump-in and pull-off of adhesive contacts, near-touching, overlapping and coincident caps, a/R
    up to 1, thin layers, zero and flattening loads, a stiff load cell, touching base planes and limits of the
    statistical models. The truth is a closed form, a limit, the equations summed one by one, or a stored
    solution of the whole contact problem. Takes seconds, the first time half a minute; writes nothing.

    Exit codes: 0 every case holds, 1 one does not.

    \b
    Examples:
      contactimg selftest
      contactimg selftest --all

    Parameters
    ----------
    every
        All cases, with 100,000 and a million asperities; takes some minutes.
    """
    with stage("loading"):
        from contactimg.hard_cases import chosen_cases, run_cases

    with progress("solving", len(chosen_cases(every=every))) as advance:
        table = run_cases(every=every, advance=advance)
    rows = [
        {
            "case": row["case"],
            "answer": str(row["said"])[:LONGEST_SENTENCE],
            "": "" if row["passed"] else "FAILS",
            "residual": f"{row['residual']:.1g}".replace("nan", ""),
            "error": f"{row['error']:.2g}".replace("nan", ""),
            "allowed": f"{row['allowed']:.2g}" if row["truth"] else "",
            "truth": row["truth"],
        }
        for row in table.to_dict("records")
    ]
    echo_table("hard cases", rows, left=3)
    failed = int((~table["passed"]).sum())
    say(f"{len(table) - failed} of {len(table)} hold" + (f", {failed} do not" if failed else ""))
    return int(failed > 0)
