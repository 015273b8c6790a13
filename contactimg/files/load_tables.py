"""Loads as laboratories write them: text of any encoding with a preamble, units in brackets, any language."""

import re
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.tables import LOADS

STANDARD_GRAVITY = 9.80665
"""Newtons that one kilogram weighs; by definition."""

NEWTONS = {
    "N": 1.0,
    "mN": 1e-3,
    "uN": 1e-6,
    "µN": 1e-6,
    "μN": 1e-6,
    "kg": STANDARD_GRAVITY,
    "g": 1e-3 * STANDARD_GRAVITY,
    "mg": 1e-6 * STANDARD_GRAVITY,
}
"""Unit of a load or of a weight -> N."""

_UNIT = re.compile(rf"[\[(_/]\s*({'|'.join(NEWTONS)})f?\s*[\])]?$")

_FRICTION = re.compile(r"reib|fric|frott|tang|later|shear|scher|quer|attrito|roz")

_FRAME = re.compile(
    r"frame|bild|im[aá]g|img|datei|file|fichier|foto|photo|^(nr|no|num|nummer|number|index|#)\.?$"
)

_SEPARATORS = ("\t", ";", ",", None)  # None: any white space


class AmbiguousLoadsError(InputError):
    """Several columns of a table may be the load."""

    def __init__(self, message: str, columns: list[str]) -> None:
        super().__init__(message)
        self.columns = columns


def decode(data: bytes) -> str:
    """Text of bytes in UTF-8, UTF-16, or else the 8-bit code of western Windows.

    Examples
    --------
    >>> decode("µN".encode("cp1252")), decode("µN".encode("utf-16"))
    ('µN', 'µN')
    """
    for encoding in ("utf-16",) if data.startswith((b"\xff\xfe", b"\xfe\xff")) else ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1")


def read_load_table(path: str | Path, *, column: str = "") -> tuple[pd.DataFrame, str]:
    r"""Loads of a text table whose header states their unit in brackets.

    Parameters
    ----------
    path : str or Path
        LabVIEW measurement (.lvm) or any text with one row a frame below a header; what stands before is
        passed over.
    column : str
        Header of the loads, where several may be it.

    Returns
    -------
    loads : DataFrame
        Columns of `contactimg.tables.LOADS`; a frame without a name is ``#k``, k its row from 1.
    columns : str
        Which columns were taken, in words.

    Raises
    ------
    InputError
        If no column names a load with its unit; the message tells the columns found.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "Kraft.lvm"
    ...     _ = path.write_text("LabVIEW Measurement\n\nBild\tKraft [mN]\nImg01.tif\t12,5\n")
    ...     table, columns = read_load_table(path)
    >>> table["load_N"].tolist(), columns
    ([0.0125], "loads from 'Kraft [mN]', frames from 'Bild'")
    """
    try:
        lines = [line.rstrip("\r\n") for line in decode(Path(path).read_bytes()).split("\n")]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    shown = ""
    for separator in _SEPARATORS:
        for number, line in enumerate(lines):
            header = [cell.strip().strip('"') for cell in line.split(separator)]
            loads = [k for k, name in enumerate(header) if _is_load(name) and column in ("", name)]
            rows = _rows_below(lines[number + 1 :], separator, len(header))
            if len(header) == 1 or not rows:
                continue
            shown = shown or ", ".join(filter(None, header))
            if loads:
                return _table(path, header, rows, loads)
    raise InputError(
        f"{path}: no column is a load with its unit, such as load_mN, load_g, Kraft [mN] or Load (N)"
        + (f"; the columns are {shown}" if shown else "")
    )


def _is_load(name: str) -> bool:
    """Whether a header names a normal load: a unit of force or weight, and no friction."""
    return _UNIT.search(name) is not None and _FRICTION.search(name.lower()) is None


def _rows_below(lines: list[str], separator: str | None, width: int) -> list[list[str]]:
    """The rows of a table up to the first line of another width; empty lines and missing last cells count."""
    rows = []
    for line in lines:
        cells = [cell.strip().strip('"') for cell in line.split(separator)]
        if not any(cells):
            continue
        if len(cells) > width or len(cells) < width - 1:
            break
        rows.append(cells + [""] * (width - len(cells)))
    return rows


def _table(
    path: str | Path, header: list[str], rows: list[list[str]], loads: list[int]
) -> tuple[pd.DataFrame, str]:
    """The loads from the rows, and the names of the columns that were taken."""
    if len(loads) > 1:
        names = ", ".join(repr(header[k]) for k in loads)
        said = f"{path}: {len(loads)} columns may be the load ({names}); rename the others"
        raise AmbiguousLoadsError(said, [header[k] for k in loads])
    frames = [k for k, name in enumerate(header) if _FRAME.search(name.lower()) and k not in loads]
    unit = _UNIT.search(header[loads[0]])
    table = {"load_N": [_number(path, row[loads[0]]) * NEWTONS[unit[1] if unit else "N"] for row in rows]}
    said = f"loads from {header[loads[0]]!r}"
    for k, name in enumerate(header):
        friction = _UNIT.search(name)
        if friction and _FRICTION.search(name.lower()) and "friction_N" not in table:
            table["friction_N"] = [_number(path, row[k]) * NEWTONS[friction[1]] for row in rows]
            said += f", friction from {name!r}"
    named = [row[frames[0]] for row in rows] if frames else [f"#{k + 1}" for k in range(len(rows))]
    said += f", frames from {header[frames[0]]!r}" if frames else ", one row a frame in their order"
    return LOADS.conform(pd.DataFrame({"frame": named} | table)), said


def _number(path: str | Path, cell: str) -> float:
    """A number with a decimal point or comma; NaN of an empty cell."""
    try:
        return float(cell.replace(",", ".")) if cell else float("nan")
    except ValueError:
        raise InputError(f"{path}: a load must be a number, got {cell!r}") from None
