"""Read and write CSV tables; errors name file, row and column, and numbers keep every digit."""

import csv
import io
import math
from collections.abc import Callable, Collection, Iterator
from itertools import islice
from pathlib import Path

import pandas as pd

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.files.load_tables import STANDARD_GRAVITY, read_load_table
from contactimg.surfaces import check_asperities
from contactimg.tables import ASPERITIES, LOADS, TOPOGRAPHY, Flag, Schema, flag_names
from contactimg.timings import stage

_BLOCK_ROWS = 50_000  # converted at once; chosen for memory: text takes about twenty times that of numbers
_SEPARATORS = (",", ";", "\t")
_LARGEST_COUNT = 2**63 - 1  # of an int64
_LONGEST_COUNT = 40  # characters; longer ones are read as floats, which are too large
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
        UTF-8 text with a header. Cells are separated by commas, semicolons or tabs, whichever the header has
        most; with semicolons or tabs a decimal comma is accepted. A column may be in another unit that its
        name states: mm, um or nm for m, mN or uN for N (load_mN, x_um).
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
    columns = _columns(Path(path), header, schema, required)
    blocks = [schema.empty()]
    while block := list(islice(rows, _BLOCK_ROWS)):
        for line, row in block:
            if len(row) != len(header):
                raise InputError(
                    f"{path}: line {line} has {len(row)} cells, but the header has {len(header)} columns"
                )
        values = dict[str, list[object]]()
        for name, (place, divisor) in columns.items():
            parse = _parser(schema, name, divisor, decimal_comma=separator != ",", infinite=infinite)
            found = values.setdefault(name, [])
            for line, row in block:
                try:
                    if name in (required or ()) and not row[place].strip():
                        raise ValueError("must have a value")
                    found.append(parse(row[place]))
                except ValueError as error:
                    got = row[place][:_SHOWN_CHARACTERS]
                    raise InputError(f"{path}: line {line}, column {name} {error}, got {got!r}") from None
        blocks.append(schema.conform(pd.DataFrame(values)))
    return pd.concat([block for block in blocks if len(block)] or blocks, ignore_index=True)


def _csv_rows(path: str | Path) -> tuple[str, Iterator[tuple[int, list[str]]]]:
    """Separator of a CSV file, and its rows with the numbers of their lines; blank lines are left out.

    Bytes that are not UTF-8 are kept: they occur in file names.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:1000]:
        raise OtherFormError(f"{path}: is not UTF-8 text; save it as 'CSV UTF-8'")
    text = data.decode("utf-8-sig", errors="surrogateescape")
    separator = max(_SEPARATORS, key=text.lstrip("\r\n").partition("\n")[0].count)
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator)

    def rows() -> Iterator[tuple[int, list[str]]]:
        try:
            yield from ((lines.line_num, row) for row in lines if any(cell.strip() for cell in row))
        except csv.Error as error:
            raise InputError(f"{path}: line {lines.line_num} is not CSV ({error})") from None

    return separator, rows()


def _columns(
    path: Path, header: list[str], schema: Schema, required: Collection[str] | None
) -> dict[str, tuple[int, float]]:
    """Column of the schema -> its place in a file, and the divisor of its numbers where the unit is another.

    A repeated, misspelt (capitals) or missing one is an error. 300 / 1e3 is 0.3, and 300 * 1e-3 need not be.
    """
    names, divisors = [], []
    for name in header:
        other = [
            (name.removesuffix(ending) + si, divisor)
            for ending, (si, divisor) in _UNITS.items()
            if name not in schema.columns and name.endswith(ending)
        ]
        right, divisor = next((one for one in other if one[0] in schema.columns), (name, 1.0))
        names.append(right)
        divisors.append(divisor)
    needed = schema.first if required is None else required
    for name in needed:
        if name.lower() not in map(str.lower, names):
            given = ", ".join(names)[:_SHOWN_CHARACTERS] or "nothing"
            raise OtherFormError(
                f"{path}: column {name} is missing; the header must name {', '.join(needed)}, got {given}"
            )
    for name in names:
        if name in schema.columns and names.count(name) > 1:
            raise InputError(f"{path}: column {name} occurs {names.count(name)} times; keep one")
        for right in schema.columns:
            if name.lower() == right.lower() and name != right:
                raise InputError(f"{path}: column {name!r} must be written {right!r}")
    return {name: (k, divisors[k]) for k, name in enumerate(names) if name in schema.columns}


def _parser(
    schema: Schema, name: str, divisor: float, *, decimal_comma: bool, infinite: bool
) -> Callable[[str], object]:
    """What makes a value of a cell of a column; it raises `ValueError` with what the cell must be."""
    kind = "flags" if name == "flags" else schema.columns[name][0]

    def number(cell: str) -> float:
        return _parse_number(cell.replace(",", ".") if decimal_comma else cell, infinite=infinite) / divisor

    parsers: dict[str, Callable[[str], object]] = {"str": str, "float64": number, "flags": _parse_flags}
    return parsers.get(kind, _parse_count)


def _parse_number(cell: str, *, infinite: bool) -> float:
    """A float; an empty cell is NaN."""
    if not cell.strip():
        return math.nan
    try:
        value = float(cell.replace("_", "?"))  # Python would take 1_000
    except ValueError:
        raise ValueError("must be a number") from None
    if math.isnan(value) or (math.isinf(value) and not infinite):
        raise ValueError("must be a finite number")
    return value


def _parse_count(cell: str) -> object:
    """An integer, also if written with decimals; an empty cell is NA."""
    if not cell.strip():
        return pd.NA
    whole = cell.strip().lstrip("+-").isdecimal() and len(cell) < _LONGEST_COUNT
    value = int(cell) if whole else _parse_number(cell, infinite=False)
    if not float(value).is_integer():
        raise ValueError("must be a whole number")
    if not -_LARGEST_COUNT - 1 <= value <= _LARGEST_COUNT:
        raise ValueError(f"must be a whole number of at most {_LARGEST_COUNT}")
    return int(value)


def _parse_flags(cell: str) -> int:
    """The sum of the named flags; an empty cell is none."""
    names = [name.strip() for name in cell.split("|") if name.strip()]
    if any(name not in Flag.__members__ for name in names):
        raise ValueError(f"must hold names of flags ({', '.join(Flag.__members__)}) joined by |")
    return sum({Flag[name].value for name in names})


def read_loads(path: str | Path, *, pulled: bool = False) -> pd.DataFrame:
    """Read the loads of a series.

    Parameters
    ----------
    path : str or Path
        CSV with columns ``frame, load_N`` (or load_mN, load_g) and, if measured, ``friction_N,
        velocity_m_s``; others are ignored. Text of another form is read as by `read_load_table`.
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
            f"{MAX_ASPERITY_HEIGHT:g}, got "
            f"{float(table['height_m'].loc[high[0]])!r}; is it in another unit?"
        )
    _check_unique(path, table, ["x_m", "y_m"])
    return table[list(ASPERITIES.filled(table).columns)]


def read_topography(path: str | Path) -> pd.DataFrame:
    """Read a profilometry table of asperities.

    Parameters
    ----------
    path : str or Path
        CSV with columns ``height_m, radius_m`` and, if known, ``height_std_m, radius_std_m``; others are
        ignored.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.TOPOGRAPHY`, m; an uncertainty that is not given is NaN.

    Raises
    ------
    InputError
        For a missing column or a cell that is no finite number.
    """
    return read_table(path, TOPOGRAPHY, required=("height_m", "radius_m"))


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
    'frame,load_N,friction_N,velocity_m_s\na.tif,0.1,,\n'
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


def read_text_rows(path: str | Path) -> tuple[str, list[list[str]]]:
    """Separator and all rows of a CSV file as text, the header first, blank lines left out.

    Raises
    ------
    InputError
        If it cannot be read or is not CSV.
    """
    separator, rows = _csv_rows(path)
    return separator, [row for _, row in rows]
