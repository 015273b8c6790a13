"""Tables between marks in the pages of the documentation."""

from pathlib import Path

ROOT = Path(__file__).parents[1]


def markdown(header, rows):
    """Lines of a table."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows),
    ]


def put_table(name, lines, *, page=ROOT / "docs/imaging.md"):
    """Print a table and put it between the marks of that name on the page."""
    print("\n".join(["", name, *lines]), flush=True)
    text = page.read_text(encoding="utf-8")
    begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
    before, after = text.split(begin)
    page.write_text(before + begin + "\n".join(lines) + "\n" + after[after.index(end) :], encoding="utf-8")
