"""Pages of the gallery: the text and code of each notebook with its stored figures; nothing is executed."""

import json
import re
from pathlib import Path

from reference_pages import write

ROOT = Path(__file__).parents[2]
NOTEBOOKS, TARGET = ROOT / "notebooks", ROOT / "docs" / "gallery"
PICTURES = "../../notebooks/results"
INTRODUCTION = [
    "Each page is a notebook of `notebooks/`: what is asked, what is done, the stored figures, and how the",
    "numbers compare with Yashima et al., *Soft Matter* **11** (2015) 871. Figures and numbers are made by",
    "`python benchmarks/run.py notebook_results.full`.",
    "",
]


def setup(app):
    """Write the pages as soon as the configuration is read."""
    app.connect("config-inited", _write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write_pages(_app, _config):
    notebooks = sorted(NOTEBOOKS.glob("*.ipynb"))
    sections = _result_sections()
    cards, pages = [], []
    for path in notebooks:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        pictures = [picture.name for picture in sorted((NOTEBOOKS / "results").glob(f"{path.stem[:3]}*.png"))]
        write(f"{path.stem}.md", _page(path, cells, pictures, sections.get(path.stem, [])), TARGET)
        title = _source(cells[0]).splitlines()[0].removeprefix("# ")
        pages.append(path.stem)
        cards += [f":::{{grid-item-card}} {title}", f":link: {path.stem}", ":link-type: doc"]
        cards += [f":img-top: {_card_picture(path.stem, pictures)}", "", ":::"]
    toc = ["```{toctree}", ":hidden:", "", *pages, "```"]
    lines = ["# Gallery", "", *INTRODUCTION, "::::{grid} 1 2 2 3", ":gutter: 3", "", *cards, "::::", "", *toc]
    write("index.md", lines, TARGET)


def _card_picture(stem, pictures):
    """The notebook's own figure, else the first, else that of the first page."""
    if not pictures:
        return "../figures/overlay.png"
    return f"{PICTURES}/{f'{stem}.png' if f'{stem}.png' in pictures else pictures[0]}"


def _page(path, cells, pictures, numbers):
    lines = []
    for cell in cells:
        if cell["cell_type"] == "markdown":
            lines += [_linked(_source(cell)), ""]
        else:
            lines += ["```python", _source(cell), "```", ""]
    others = [name for name in pictures if name not in "\n".join(lines)]
    if others:
        lines += ["## Stored figures", "", *(f"![{name}]({PICTURES}/{name})\n" for name in others)]
    if numbers:
        lines += ["## Stored numbers", "", *numbers, ""]
    return [*lines, f"The notebook: {{download}}`{path.name} <../../notebooks/{path.name}>`."]


def _source(cell):
    return "".join(cell["source"])


def _linked(text):
    """Links between notebooks lead to pages of the gallery, stored figures to where they are stored."""
    text = re.sub(r"\]\((\d\d_\w+)\.ipynb\)", r"](\1.md)", text)
    return text.replace("](results/", f"]({PICTURES}/")


def _result_sections():
    """Notebook -> the lines of its table in notebooks/results/README.md."""
    text = (NOTEBOOKS / "results" / "README.md").read_text(encoding="utf-8")
    parts = re.split(r"^## \[(\w+)\].*\n", text, flags=re.MULTILINE)
    return {name: body.strip().splitlines() for name, body in zip(parts[1::2], parts[2::2], strict=True)}
