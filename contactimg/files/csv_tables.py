"""Read and write CSV tables; errors name file, row and column, and numbers keep every digit.

`read_table` reads what a schema describes. Loads are read as laboratories write them too (`read_load_table`):
text of any encoding with a preamble, units in brackets, any language.
"""

import csv
import io
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.surfaces import check_asperities
from contactimg.tables import ASPERITIES, LOADS, Flag, Schema, flag_names
from contactimg.timings import stage

STANDARD_GRAVITY = 9.80665
"""Newtons that one kilogram weighs; by definition."""

_BLOCK_ROWS = 50_000  # converted at once; chosen for memory: text takes about twenty times that of numbers
_SEPARATORS = (",", ";", "\t")
_LARGEST_COUNT = 2**63 - 1  # of an int64
_UNITS = {  # ending in another unit -> ending in the schema, how many make one of it
    "_mm": ("_m", 1e3),
    "_um": ("_m", 1e6),
    "_µm": ("_m", 1e6),
    "_μm": ("_m", 1e6),
    "_nm": ("_m", 1e9),
    "_mN": ("_N", 1e3),
    "_uN": ("_N", 1e6),
    "_g": ("_N", 1e3 / STANDARD_GRAVITY),
    "_mm_s": ("_m_s", 1e3),
    "_um_s": ("_m_s", 1e6),
}
_SHOWN_CHARACTERS = 60  # of a cell or header in a message

MAX_ASPERITY_HEIGHT = 0.01
"""Height in m above which a value is taken to be in another unit. Chosen by hand."""


class OtherFormError(InputError):
    """A table is not of the form that its schema asks for."""


@stage("reading")
def read_table(
    path: str | Path,
    schema: Schema,
    *,
    required: Collection[str] | None = None,
    infinite: bool = False,
) -> pd.DataFrame:
    """Read a CSV file of a known schema.

    Parameters
    ----------
    path : str or Path
        Text in UTF-8 or UTF-16 with a header. Cells are separated by commas, semicolons or tabs, whichever
        the header has most; with semicolons or tabs a decimal comma is accepted. A column may be in another
        unit that its name states: mm, um or nm for m, mN or uN for N (load_mN, x_um).
    schema : Schema
        The columns to read; others in the file are ignored, and blank lines are skipped.
    required : collection of str, optional
        Columns that must be present with a value in every row. By default all columns must be present but
        those that a later version added (`Schema.later`), and cells may be empty.
    infinite : bool
        Whether ``inf`` is accepted.

    Returns
    -------
    DataFrame
        The columns of the schema, in its order; an empty cell is NaN, NA or the empty text.

    Raises
    ------
    InputError
        With the file, and the line and column of the first cell that is not valid.
    """
    separator, rows = _csv_rows(path)
    header = [name.strip() for name in next(rows, (1, []))[1]]
    columns = _columns(path, header, schema, schema.first if required is None else required)
    blocks = [schema.empty()]
    while block := list(islice(rows, _BLOCK_ROWS)):
        for line, row in block:
            if len(row) != len(header):
                raise InputError(
                    f"{path}: line {line} has {len(row)} cells, but the header has {len(header)} columns"
                )
        values: dict[str, list[object]] = {name: [] for name in columns}
        for name, (place, divisor) in columns.items():
            kind = "flags" if name == "flags" else schema.columns[name][0]
            must, found = name in (required or ()), values[name]
            comma = separator != "," and kind != "str"
            for line, row in block:
                cell = row[place]
                try:
                    if must and not cell.strip():
                        raise ValueError("must have a value")
                    value = _parsed(cell.replace(",", ".") if comma else cell, kind, infinite=infinite)
                except ValueError as error:
                    got = cell[:_SHOWN_CHARACTERS]
                    raise InputError(f"{path}: line {line}, column {name} {error}, got {got!r}") from None
                # 300 / 1e3 is 0.3, and 300 * 1e-3 need not be
                found.append(value if divisor == 1 else value / divisor)
        blocks.append(schema.conform(pd.DataFrame(values)))
    return pd.concat([block for block in blocks if len(block)] or blocks, ignore_index=True)


def _text(path: str | Path) -> str:
    """Text of a file in UTF-8 or UTF-16; other bytes are kept, since they occur in names of files."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    return data.decode("utf-16" if wide else "utf-8-sig", errors="replace" if wide else "surrogateescape")


def _csv_rows(path: str | Path) -> tuple[str, Iterator[tuple[int, list[str]]]]:
    """Separator of a CSV file, and its rows with the numbers of their lines; blank lines are left out."""
    text = _text(path)
    if "\0" in text[:1000]:
        raise OtherFormError(f"{path}: is no text; save it as 'CSV UTF-8'")
    separator = max(_SEPARATORS, key=text.lstrip("\r\n").partition("\n")[0].count)
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator)

    def rows() -> Iterator[tuple[int, list[str]]]:
        try:
            yield from ((lines.line_num, row) for row in lines if any(cell.strip() for cell in row))
        except csv.Error as error:
            raise InputError(f"{path}: line {lines.line_num} is not CSV ({error})") from None

    return separator, rows()


def read_text_table(path: str | Path) -> tuple[str, pd.DataFrame]:
    """Separator and all cells of a CSV file as text, whatever its columns; blank lines are left out.

    Raises
    ------
    InputError
        If it cannot be read or is not CSV.
    """
    separator, rows = _csv_rows(path)
    header, *cells = [row for _, row in rows]
    return separator, pd.DataFrame(cells, columns=[name.strip() for name in header], dtype="str")


def _columns(
    path: str | Path, header: list[str], schema: Schema, needed: Collection[str]
) -> dict[str, tuple[int, float]]:
    """Column of the schema -> its place in a file, and the divisor of its numbers where the unit is another.

    A repeated, misspelt (capitals) or missing one is an error.
    """
    found = list[tuple[str, float]]()
    for name in header:
        units = (
            (name.removesuffix(ending) + si, size)
            for ending, (si, size) in _UNITS.items()
            if name.endswith(ending)
        )
        other = (one for one in units if name not in schema.columns and one[0] in schema.columns)
        found.append(next(other, (name, 1.0)))
    names = [name for name, _ in found]
    spelled = {name.lower(): name for name in schema.columns}
    for name in needed:
        if name.lower() not in map(str.lower, names):
            given = ", ".join(names)[:_SHOWN_CHARACTERS] or "nothing"
            raise OtherFormError(
                f"{path}: column {name} is missing; the header must name {', '.join(needed)}, got {given}"
            )
    for name in names:
        right = spelled.get(name.lower(), name)
        if name != right:
            raise InputError(f"{path}: column {name!r} must be written {right!r}")
        if name in schema.columns and names.count(name) > 1:
            raise InputError(f"{path}: column {name} occurs {names.count(name)} times; keep one")
    return {name: (k, size) for k, (name, size) in enumerate(found) if name in schema.columns}


def _parsed(cell: str, kind: str, *, infinite: bool = False) -> Any:
    """The value of a cell; an empty one is the empty text, NaN, NA or no flag.

    Raises
    ------
    ValueError
        With what the cell must be.
    """
    if kind == "str":
        return cell
    if kind == "flags":
        names = {name.strip() for name in cell.split("|")} - {""}
        if not names <= set(Flag.__members__):
            raise ValueError(f"must hold names of flags ({', '.join(Flag.__members__)}) joined by |")
        return sum(Flag[name].value for name in names)
    if not cell.strip():
        return math.nan if kind == "float64" else pd.NA
    if kind != "float64" and re.fullmatch(r"\s*[+-]?\d{1,30}\s*", cell):
        value: float = int(cell)
    else:
        try:
            value = float(cell.replace("_", "?"))  # Python would take 1_000
        except ValueError:
            raise ValueError("must be a number") from None
        if math.isnan(value) or (math.isinf(value) and not (infinite and kind == "float64")):
            raise ValueError("must be a finite number")
    if kind == "float64":
        return value
    if value % 1:
        raise ValueError("must be a whole number")
    if not -_LARGEST_COUNT - 1 <= value <= _LARGEST_COUNT:
        raise ValueError(f"must be a whole number of at most {_LARGEST_COUNT}")
    return int(value)


def read_loads(path: str | Path, *, pulled: bool = False) -> pd.DataFrame:
    """Read the loads of a series.

    Parameters
    ----------
    path : str or Path
        CSV with columns ``frame, load_N`` (or load_mN, load_g) and, if measured, ``friction_N,
        velocity_m_s, tangential_N, time_s``; others are ignored. Text of another form is read as by
        `read_load_table`.
    pulled : bool
        Whether negative loads are allowed (tension on an adhesive contact).

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.LOADS`; loads in N, one row per frame.

    Raises
    ------
    InputError
        For a missing column, a cell that is no finite number, a negative load that is not allowed, or a
        repeated frame.
    """
    try:
        table = read_table(path, LOADS, required=("frame", "load_N"))
    except OtherFormError as error:
        try:
            table, columns = read_load_table(path)
        except InputError as other:
            raise InputError(f"{error}; {str(other).removeprefix(f'{path}: ')}") from None
        table.attrs["columns"] = columns
    table["frame"] = table["frame"].str.strip()
    negative = table[table["load_N"] < 0]
    if len(negative) and not pulled:
        row = negative.iloc[0]
        raise InputError(
            f"{path}: load_N of {row['frame']} must not be negative, got {row['load_N']}; "
            "only an adhesive contact (`calibrate jkr`) carries a negative load"
        )
    _check_unique(path, table, ["frame"])
    return table


def read_asperities(path: str | Path) -> pd.DataFrame:
    """Read an asperity table.

    Parameters
    ----------
    path : str or Path
        CSV with columns ``x_m, y_m, height_m, radius_m``, and those of `contactimg.tables.ASPERITIES` that
        may be missing or empty; others are ignored.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.ASPERITIES`, without the optional ones that are empty; at least one
        row.

    Raises
    ------
    InputError
        For a missing column, a cell that is no finite number, a radius that is not positive, a height
        above `MAX_ASPERITY_HEIGHT`, an empty table, or two asperities at the same position.
    """
    table = read_table(path, ASPERITIES, required=ASPERITIES.first)
    if table.empty:
        raise InputError(f"{path}: the table has no row; it needs at least one asperity")
    try:
        check_asperities(table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    high = table.index[table["height_m"].abs() > MAX_ASPERITY_HEIGHT]
    if len(high):
        raise InputError(
            f"{path}: asperities: row {high[0]}, column 'height_m' must be metres, at most "
            f"{MAX_ASPERITY_HEIGHT:g}, got {float(table['height_m'].loc[high[0]])!r}; is it in another unit?"
        )
    _check_unique(path, table, ["x_m", "y_m"])
    return table[list(ASPERITIES.filled(table).columns)]


def _check_unique(path: str | Path, table: pd.DataFrame, columns: list[str]) -> None:
    """Raise if two rows agree in the columns."""
    repeated = table[table.duplicated(columns)]
    if len(repeated):
        value = ", ".join(str(cell) for cell in repeated.iloc[0][columns])
        raise InputError(f"{path}: {', '.join(columns)} {value} is there more than once; keep one row")


@stage("writing")
def write_table(table: pd.DataFrame, schema: Schema, path: str | Path) -> None:
    r"""Write a table as CSV, whole or not at all.

    Parameters
    ----------
    table : DataFrame
        Rows of the schema; missing columns are written empty.
    schema : Schema
        The columns and their order.
    path : str or Path
        UTF-8 with commas and line ends ``\n``. Numbers have the fewest digits that restore the same float;
        NaN and NA are empty cells; flags are names joined by ``|``.

    Raises
    ------
    InputError
        If the table does not fit the schema or the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "loads.csv"
    ...     write_table(pd.DataFrame({"frame": ["a.tif"], "load_N": [0.1]}), LOADS, path)
    ...     path.read_text()
    'frame,load_N,friction_N,velocity_m_s,tangential_N,time_s\na.tif,0.1,,,,\n'
    """
    with replacing(path) as part:
        text = ",".join(schema.columns) + "\n" + text_of_rows(table, schema)
        part.write_text(text, encoding="utf-8", errors="surrogateescape", newline="")


def text_of_rows(table: pd.DataFrame, schema: Schema) -> str:
    """The rows of a table as `write_table` writes them."""
    whole = schema.conform(table)
    if "flags" in whole:
        whole["flags"] = flag_names(whole["flags"])
    return str(whole.to_csv(header=False, index=False, lineterminator="\n"))


# --- loads as laboratories write them

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


class AmbiguousLoadsError(InputError):
    """Several columns of a table may be the load."""

    def __init__(self, message: str, columns: list[str]) -> None:
        super().__init__(message)
        self.columns = columns


def read_load_table(path: str | Path, *, column: str = "") -> tuple[pd.DataFrame, str]:
    r"""Loads of a text table whose header states their unit in brackets.

    Parameters
    ----------
    path : str or Path
        LabVIEW measurement (.lvm) or any text with one row a frame below a header; what stands before is
        passed over. In UTF-8, UTF-16, or else the 8-bit code of western Windows.
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
    text, shown = _text(path), ""
    if re.search("[\udc80-\udcff]", text):  # bytes that are not UTF-8
        text = text.encode("utf-8", errors="surrogateescape").decode("cp1252", errors="replace")
    for separator in ("\t", ";", ",", None):  # None: any white space
        lines = [[cell.strip().strip('"') for cell in line.split(separator)] for line in text.split("\n")]
        for number, header in enumerate(lines):
            rows = _rows_below(lines[number + 1 :], len(header)) if len(header) > 1 else []
            if rows:
                shown = shown or ", ".join(filter(None, header))
                loads = [name for name in header if _is_load(name) and column in ("", name)]
                if loads:
                    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
                    return _load_rows(path, columns, loads)
    raise InputError(
        f"{path}: no column is a load with its unit, such as load_mN, load_g, Kraft [mN] or Load (N)"
        + (f"; the columns are {shown}" if shown else "")
    )


def _is_load(name: str) -> bool:
    """Whether a header names a normal load: a unit of force or weight, and no friction."""
    return _UNIT.search(name) is not None and _FRICTION.search(name.lower()) is None


def _rows_below(lines: list[list[str]], width: int) -> list[list[str]]:
    """The rows of a table up to the first line of another width; a missing last cell is empty."""
    rows = []
    for cells in filter(any, lines):
        if not width - 1 <= len(cells) <= width:
            break
        rows.append(cells + [""] * (width - len(cells)))
    return rows


def _load_rows(
    path: str | Path, columns: Mapping[str, Sequence[str]], loads: list[str]
) -> tuple[pd.DataFrame, str]:
    """The loads from the cells of each column, and the names of the columns that were taken."""
    if len(loads) > 1:
        several = ", ".join(map(repr, loads))
        raise AmbiguousLoadsError(
            f"{path}: {len(loads)} columns may be the load ({several}); rename the others", loads
        )
    frames = [name for name in columns if _FRAME.search(name.lower()) and name not in loads]
    frictions = [name for name in columns if _UNIT.search(name) and _FRICTION.search(name.lower())]
    table, said = dict[str, Sequence[object]](), list[str]()
    for what, target, names in (("loads", "load_N", loads), ("friction", "friction_N", frictions)):
        for name in names[:1]:
            newtons = NEWTONS[_UNIT.search(name)[1]]  # type: ignore[index]
            table[target] = [_number(path, cell) * newtons for cell in columns[name]]
            said.append(f"{what} from {name!r}")
    numbers = [f"#{k + 1}" for k in range(len(columns[loads[0]]))]
    table["frame"] = columns[frames[0]] if frames else numbers
    said.append(f"frames from {frames[0]!r}" if frames else "one row a frame in their order")
    return LOADS.conform(pd.DataFrame(table)), ", ".join(said)


def _number(path: str | Path, cell: str) -> float:
    """A number with a decimal point or comma; NaN of an empty cell."""
    try:
        return float(cell.replace(",", ".")) if cell else math.nan
    except ValueError:
        raise InputError(f"{path}: a load must be a number, got {cell!r}") from None
