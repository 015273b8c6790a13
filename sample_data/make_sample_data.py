"""Make the synthetic sample data again, and bring the table of checksums in README.md up to date.

    python sample_data/make_sample_data.py

`sa_plus/` is simulated from `sa_plus.toml`; `pins/` holds camera images made elsewhere and is left alone.
"""

import hashlib
from pathlib import Path

from contactimg.files import read_scene
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation

HERE = Path(__file__).parent
TABLE_HEAD = "| file | bytes | origin | sha256 |\n|---|---|---|---|\n"
NOT_DATA = {"README.md", "make_sample_data.py"}


def make_sa_plus() -> None:
    """Solve and render the scene at its loads."""
    scene = read_scene(HERE / "sa_plus.toml")
    folder = HERE / "sa_plus"
    folder.mkdir(exist_ok=True)
    write_simulation(scene, need_asperities(scene, "the sample data"), folder)


def data_files() -> list[Path]:
    """The files that belong to the sample data, outputs of the commands apart."""
    files = (path for path in HERE.rglob("*") if path.is_file())
    inside = ((path, path.relative_to(HERE).parts) for path in files)
    return sorted(
        path
        for path, parts in inside
        if path.name not in NOT_DATA and not {"contactimg_out", "__pycache__"} & set(parts)
    )


def describe_file(path: Path) -> str:
    """One row of the table."""
    name = path.relative_to(HERE).as_posix()
    if name.startswith("sa_plus"):
        origin = "synthetic"
    else:
        origin = "contactimg" if path.suffix == ".toml" else "9DTact"
    content = path.read_bytes()
    return f"| {name} | {len(content)} | {origin} | {hashlib.sha256(content).hexdigest()} |\n"


def update_readme() -> None:
    """Replace the table at the end of README.md."""
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8").split(TABLE_HEAD)[0]
    rows = "".join(describe_file(path) for path in data_files())
    readme.write_text(text + TABLE_HEAD + rows, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    make_sa_plus()
    update_readme()
