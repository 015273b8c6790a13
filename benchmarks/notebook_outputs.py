"""Store the notebooks with what they show: run each with its small ensembles, and keep its outputs.

    python benchmarks/notebook_outputs.py [NAME ...]

NAMEs are the beginnings of notebooks ("02 05"). Figures are stored with few colours, so that a notebook stays
below 400 kB; their full versions are those of `notebook_results.py`.
"""

import argparse
import base64
import io
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
WIDTH_PX, COLOURS = 900, 48


def smaller(figure: str) -> str:
    """A PNG in base64 with few colours, at most `WIDTH_PX` wide."""
    image = Image.open(io.BytesIO(base64.b64decode(figure))).convert("RGB")
    if image.width > WIDTH_PX:
        image = image.resize(
            (WIDTH_PX, round(image.height * WIDTH_PX / image.width)), Image.Resampling.LANCZOS
        )
    out = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


def store(path: Path) -> None:
    """Run a notebook and store it with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=None, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()
    reduce_outputs(notebook)
    nbformat.write(notebook, path)


def reduce_outputs(notebook: nbformat.NotebookNode) -> None:
    """Make the figures small, and drop what tells when and where a notebook ran."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = smaller(data["image/png"])
        cell["outputs"] = [o for o in cell.get("outputs", []) if o.get("name") != "stderr"]
        if cell.cell_type != "code":
            cell.pop("outputs")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="beginnings of the notebooks to run")
    names = tuple(parser.parse_args().names)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        if not names or path.name.startswith(names):
            store(path)
            print(f"{path.name}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
