"""Read and write tables: CSV, as laboratories write it too, and those of a run as CSV or Parquet.

`read_table` reads what a schema describes; errors name file, row and column, and numbers keep every digit.
Loads are read as laboratories write them (`read_loads`): text of any encoding with a preamble, units in
brackets, any language. The tables of a run are written a few frames at a time.
"""

import csv
import importlib
import io
import math
import re
from collections.abc import Collection, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import pandas as pd
from scipy import constants

from contactimg.errors import InputError
from contactimg.files.atomic import explaining, first_names, naming, read_bytes, write_text
from contactimg.pose.pose import LARGEST_LENGTH
from contactimg.surfaces import check_asperities
from contactimg.tables import ASPERITIES, CONTACTS, FRAMES, LOADS, Flag, Schema, flag_names

PER_NEWTON = {"N": 1.0, "mN": 1e3, "uN": 1e6, "µN": 1e6, "μN": 1e6}
PER_NEWTON |= {"kg": 1 / constants.g, "g": 1e3 / constants.g, "mg": 1e6 / constants.g}
"""Unit of a load or of a weight -> how many of it are one newton."""

METRES = {"m": 1.0, "mm": 1e-3, "millimeter": 1e-3, "nm": 1e-9}
METRES |= dict.fromkeys(("um", "micron", "microns", "micrometer", "µm", "μm", "\\u00b5m"), 1e-6)
"""Unit of a length -> its size in m; um also with the micro sign, a Greek letter, or as ImageJ has it."""

_PER_METRE = {unit: round(1 / size) for unit, size in METRES.items()}
_UNITS = {  # ending in another unit -> ending in the schema, how many make one of it
    **{f"_{unit}": ("_N", count) for unit, count in PER_NEWTON.items()},
    **{f"_{unit}": ("_m", count) for unit, count in _PER_METRE.items()},
    **{f"_{unit}_s": ("_m_s", count) for unit, count in _PER_METRE.items()},
    **{f"_{unit}2": ("_m2", count**2) for unit, count in _PER_METRE.items()},
}
_Places = dict[str, tuple[int, float]]
"""Column of a schema -> its place in a row, and the divisor of its numbers."""
_COMMENT = re.compile(r"\s*#(?!\d)")  # at the start of a line; #1 is the name of a frame
_SHOWN_CHARACTERS = 60  # of a cell or header in a message
_KINDS = {
    b"PK": "an Excel workbook or another zip file",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook",
    **dict.fromkeys((b"II", b"MM", b"\x89PNG", b"\xff\xd8", b"BM"), "an image"),
}
"""First bytes of a file that is no text -> what it is."""


class OtherFormError(InputError):
    """A table has not the columns that are asked for."""


def read_table(
    path: str | Path, schema: Schema, *, required: Collection[str] | None = None, infinite: bool = False
) -> pd.DataFrame:
    """Read a CSV file of a known schema.

    Parameters
    ----------
    path : str or Path
        Text in UTF-8 or UTF-16 with a header. Cells are separated by commas, semicolons or tabs, whichever
        the header has most; with semicolons or tabs a decimal comma is accepted. A column may be in another
        unit that its name states: mm, um or nm for m, mN or uN for N (load_mN, x_um, area_mm2).
    schema : Schema
        The columns to read; blank lines are skipped.
    required : collection of str, optional
        For tables written by hand: columns that must be present with a value in every row; what follows a #
        at the start of a line or in a number is skipped. By default the table is one of a run: all columns
        must be present but those that a later version added (`Schema.later`), and cells may be empty.
    infinite : bool
        Whether ``inf`` is accepted.

    Returns
    -------
    DataFrame
        The columns of the schema, in its order; an empty cell is NaN, NA or the empty text. Where one is
        missing, ``attrs["remark"]`` names the columns of the file that are not read.

    Raises
    ------
    InputError
        With the file, and the line and column of the first cell that is not valid.
    """
    separator, rows = _csv_rows(path, by_hand=required is not None)
    header = [name.strip() for name in next(rows, (1, []))[1]]
    needed = schema.first if required is None else required
    places, comma = _places(path, header, schema, needed), separator != ","
    table = _converted(path, rows, places, schema, required or (), infinite=infinite, decimal_comma=comma)
    missing, taken = [name for name in schema.columns if name not in places], {k for k, _ in places.values()}
    if missing and (unread := [repr(name) for k, name in enumerate(header) if name and k not in taken]):
        table.attrs["remark"] = f"not read: {first_names(unread)}; it may also hold {', '.join(missing)}"
    return table


def _converted(
    path: str | Path,
    rows: Iterable[tuple[int, list[str]]],
    places: _Places,
    schema: Schema,
    required: Collection[str] = (),
    *,
    infinite: bool = False,
    decimal_comma: bool = True,
) -> pd.DataFrame:
    """The table of rows of text, each with the number of its line.

    Raises
    ------
    InputError
        With line and column of the first cell that is not valid.
    """
    numbers = sorted(place for name, (place, _) in places.items() if schema.columns[name][0] != "str")
    blocks, rows = list[pd.DataFrame](), ((line, _up_to_comment(row, numbers)) for line, row in rows)
    # so many at once, chosen for memory: text takes about twenty times that of numbers
    while block := list(islice(rows, 50_000)):
        values: dict[str, Any] = {}
        for name, (place, divisor) in places.items():
            kind, column = "flags" if name == "flags" else schema.columns[name][0], list[Any]()
            commas, needed = decimal_comma and kind != "str", name in required
            try:
                for line, row in block:  # noqa: B007 - the line is told where a cell is not valid
                    cell = row[place].replace(",", ".") if commas else row[place]
                    if needed and not cell.strip():
                        raise ValueError("must have a value")
                    value = _parsed(cell, kind, infinite=infinite)
                    # 300 / 1e3 is 0.3, and 300 * 1e-3 need not be
                    column.append(value if divisor == 1 else value / divisor)
            except ValueError as error:
                got = row[place][:_SHOWN_CHARACTERS]
                raise InputError(f"{path}: line {line}, column {name} {error}, got {got!r}") from None
            values[name] = column
        blocks.append(schema.conform(pd.DataFrame(values)))
    return schema.joined(blocks)


def read_text(path: str | Path) -> str:
    """Text of a file in UTF-8 or UTF-16; other bytes are kept, since they occur in names of files."""
    data = read_bytes(path)
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = data.decode("utf-16" if wide else "utf-8-sig", errors="replace" if wide else "surrogateescape")
    if "\0" in text[:1000]:
        kind = next((kind for start, kind in _KINDS.items() if data.startswith(start)), "a binary file")
        raise InputError(f"{path}: is {kind}, not text; save the table as 'CSV UTF-8' and name that file")
    return text


def in_western_code(text: str) -> str:
    """Text of `read_text`; bytes that are not UTF-8 are taken for the 8-bit code of western Windows."""
    if not re.search("[\udc80-\udcff]", text):
        return text
    return text.encode("utf-8", errors="surrogateescape").decode("cp1252", errors="replace")


def _csv_rows(path: str | Path, *, by_hand: bool = True) -> tuple[str, Iterator[tuple[int, list[str]]]]:
    """Separator of a CSV file, and its rows with the numbers of their lines, without blanks and comments.

    Tables that were not written by hand have no comments.
    """
    text = read_text(path)
    if by_hand:  # a line without a separator is no header
        text = re.sub(r"(?m)^[ \t]*#[^,;\t\n]*$", "", text)
    separator = max((",", ";", "\t"), key=text.lstrip("\r\n").partition("\n")[0].count)
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=separator)

    def rows() -> Iterator[tuple[int, list[str]]]:
        width = 0
        try:
            for cells in lines:
                if not any(map(str.strip, cells)) or (by_hand and width and _COMMENT.match(cells[0])):
                    continue
                row = _without_comment(cells, width) if width else [cells[0].removeprefix("# "), *cells[1:]]
                width = width or len(row)
                if len(row) != width:
                    cure = "; decimal commas need semicolons between cells"
                    raise InputError(
                        f"{path}: line {lines.line_num} has {len(row)} cells, but the header has {width} "
                        f"columns{cure if separator == ',' and len(row) > width else ''}"
                    )
                yield lines.line_num, row
        except csv.Error as error:
            raise InputError(f"{path}: line {lines.line_num} is not CSV ({error})") from None

    return separator, rows()


def _without_comment(row: list[str], width: int) -> list[str]:
    """The cells of a row without empty ones, or those of a comment, behind the last one."""
    last, beyond = "".join(row[width - 1 : width]), "".join(row[width : width + 1])
    return row[:width] if "#" in last or _COMMENT.match(beyond) or not "".join(row[width:]).strip() else row


def _up_to_comment(row: list[str], numbers: Iterable[int]) -> list[str]:
    """The cells of a row, empty from the # on that is in one of the cells of ``numbers``."""
    k = next((k for k in numbers if "#" in row[k]), None)
    return row if k is None else [*row[:k], row[k].partition("#")[0], *[""] * (len(row) - k - 1)]


def read_text_table(path: str | Path, schema: Schema) -> tuple[str, pd.DataFrame]:
    """Separator and all cells of a CSV file as text; blank lines are left out.

    Columns of the schema have its names, whatever their capitals in the file; all others are there as well.

    Raises
    ------
    InputError
        If it cannot be read or is not CSV.
    """
    separator, rows = _csv_rows(path)
    header, *cells = [row for _, row in rows]
    names = [_in_schema(name.strip(), schema)[0] for name in header]
    return separator, pd.DataFrame(cells, columns=names, dtype="str")


def _places(path: str | Path, header: list[str], schema: Schema, needed: Collection[str]) -> _Places:
    """Where the columns of a schema stand; a repeated or missing one is an error."""
    found = [_in_schema(name, schema) for name in header]
    names = [name for name, _ in found]
    for name in needed:
        if name not in names:
            given = ", ".join(names)[:_SHOWN_CHARACTERS] or "nothing"
            raise OtherFormError(
                f"{path}: column {name} is missing; the header must name {', '.join(needed)}, got {given}"
            )
    for name in schema.columns:
        if names.count(name) > 1:
            written = ", ".join(given for given, one in zip(header, names, strict=True) if one == name)
            raise InputError(f"{path}: column {name} occurs {names.count(name)} times ({written}); keep one")
    return {name: (k, size) for k, (name, size) in enumerate(found) if name in schema.columns}


def _in_schema(name: str, schema: Schema) -> tuple[str, float]:
    """Name of a column as the schema has it, and how many of the unit in the header are one of the schema.

    Capitals tell units apart (mN and MN), not the names of the schema.
    """
    known = {column.lower(): column for column in schema.columns}
    if name.lower() in known:
        return known[name.lower()], 1.0
    for ending, (si, count) in _UNITS.items():
        if name.endswith(ending) and name.removesuffix(ending) + si in schema.columns:
            return name.removesuffix(ending) + si, count
    return name, 1.0


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
    try:
        number = float(cell.replace("_", "?"))  # Python would take 1_000
    except ValueError:
        raise ValueError("must be a number") from None
    if not math.isfinite(number) and not (math.isinf(number) and infinite and kind == "float64"):
        raise ValueError("must be a finite number")
    if kind == "float64":
        return number
    if number % 1:
        raise ValueError("must be a whole number")
    value = int(cell) if cell.strip().lstrip("+-").isdecimal() else int(number)  # the former is exact
    stored = np.iinfo(np.int64)
    if not stored.min <= value <= stored.max:
        raise ValueError(f"must be a whole number of at most {stored.max}")
    return value


def read_loads(path: str | Path, *, pulled: bool = False, column: str = "") -> pd.DataFrame:
    r"""Read the loads of a series.

    Parameters
    ----------
    path : str or Path
        CSV with columns ``frame, load_N`` (or load_mN, load_g) and, if measured, ``friction_N,
        velocity_m_s, tangential_N, time_s``. Or any text with one row a frame below a header that states the
        unit of the loads in brackets, LabVIEW measurements (.lvm) among them; what stands before is passed
        over. In UTF-8, UTF-16, or else the 8-bit code of western Windows.
    pulled : bool
        Whether negative loads are allowed (tension on an adhesive contact).
    column : str
        Header of the loads, where several may be it.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.LOADS`; loads in N, one row per frame; a frame without a name is
        ``#k``, k its row from 1. What of the file was not read stands in ``attrs["remark"]``, which columns
        were chosen in ``attrs["columns"]``.

    Raises
    ------
    InputError
        For a missing column, a cell that is no finite number, a negative load that is not allowed, or a
        repeated frame.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "Kraft.lvm"
    ...     _ = path.write_text("LabVIEW Measurement\n\nBild\tKraft [mN]\nImg01.tif\t12,5\n")
    ...     table = read_loads(path)
    >>> table["load_N"].tolist(), table.attrs["columns"]
    ([0.0125], "loads from 'Kraft [mN]', frames from 'Bild'")
    """
    try:
        table = read_table(path, LOADS, required=("frame", "load_N"))
    except OtherFormError as error:
        try:
            table = _loads_of_any_form(path, column)
        except OtherFormError as other:
            raise InputError(f"{error}; {str(other).removeprefix(f'{path}: ')}") from None
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
        CSV with columns ``x_m, y_m, height_m, radius_m``; others are ignored.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.ASPERITIES`; at least one row.

    Raises
    ------
    InputError
        For a missing column, a cell that is no finite number, a radius that is not positive, a height
        above `LARGEST_LENGTH`, an empty table, or two asperities at the same position.
    """
    table = read_table(path, ASPERITIES, required=ASPERITIES.first)
    if table.empty:
        raise InputError(f"{path}: the table has no row; it needs at least one asperity")
    with naming(path):
        check_asperities(table)
    high = table.index[table["height_m"].abs() > LARGEST_LENGTH]
    if len(high):
        raise InputError(
            f"{path}: asperities: row {high[0]}, column 'height_m' must be metres, at most "
            f"{LARGEST_LENGTH:g}, got {float(table['height_m'].loc[high[0]])!r}; is it in another unit?"
        )
    _check_unique(path, table, ["x_m", "y_m"])
    return table


def _check_unique(path: str | Path, table: pd.DataFrame, columns: list[str]) -> None:
    """Raise if two rows agree in the columns."""
    repeated = table[table.duplicated(columns)]
    if len(repeated):
        value = ", ".join(str(cell) for cell in repeated.iloc[0][columns])
        raise InputError(f"{path}: {', '.join(columns)} {value} is there more than once; keep one row")


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
    write_text(f"{','.join(schema.columns)}\n{encoded_rows(table, schema)}", path)


# --- loads as laboratories write them

_UNIT = re.compile(rf"[\[(_/]\s*({'|'.join(PER_NEWTON)})f?\s*[\])]?$")
_FRICTION = re.compile(r"reib|fric|frott|tang|later|shear|scher|quer|attrito|roz")
_FRAME = re.compile(r"frame|bild|im[aá]?g|datei|file|fichier|foto|photo|^(n[ro]|num(mer|ber)?|index|#)\.?$")


class AmbiguousLoadsError(InputError):
    """Several columns of a table may be the load."""

    def __init__(self, message: str, columns: list[str]) -> None:
        super().__init__(message)
        self.columns = columns


def _our_name(header: str) -> str:
    """The name of a column of loads: load_mN for Kraft [mN], friction_N, frame; empty for another one."""
    unit, words = _UNIT.search(header), header.lower()
    if unit is None:
        return "frame" if _FRAME.search(words) else ""
    return f"{'friction' if _FRICTION.search(words) else 'load'}_{unit[1]}"


def _loads_of_any_form(path: str | Path, column: str) -> pd.DataFrame:
    """The loads of the first table in a text that has a column of them, in a unit that its header states."""
    texts, shown = in_western_code(read_text(path)).split("\n"), ""
    for separator in ("\t", ";", ",", None, "\n"):  # None: any white space; a line end: a single column

        def parted(line: str, separator: str | None = separator) -> list[str]:
            # elsewhere a name may hold a blank and a #
            line = line.partition(" #")[0] if separator in (None, "\n") else line
            return [cell.strip().strip('"') for cell in line.split(separator)]

        lines = [[] if _COMMENT.match(line) else parted(line) for line in texts]
        # numpy marks a header as a comment
        for number, header in enumerate((parted(line.removeprefix("# ")) for line in texts), start=1):
            ours = [_our_name(name) for name in header]
            loads = [k for k, name in enumerate(ours) if name[:5] == "load_" and column in ("", header[k])]
            if (shown and not loads) or (len(header) < 2 and separator != "\n"):
                continue  # the rows below each line of a long table would take long
            rows = _rows_below(lines, number, len(header))
            if not rows:
                continue
            shown = shown or ", ".join(filter(None, header))
            loads = [k for k in loads if any(row[k] for _, row in rows)]
            if len(loads) > 1:
                names = [header[k] for k in loads]
                several = ", ".join(map(repr, names))
                raise AmbiguousLoadsError(
                    f"{path}: {len(names)} columns may be the load ({several}); rename the others", names
                )
            if loads:
                table = _load_rows(path, header, ours, rows, loads[0])
                last = rows[-1][0]
                if any(map(any, lines[last:])):
                    table.attrs["remark"] = f"is read up to line {last}; a row below has another width"
                return table
    raise OtherFormError(
        f"{path}: no column is a load with its unit, such as load_mN, load_g, Kraft [mN] or Load (N)"
        + (f"; the columns are {shown}" if shown else "")
    )


def _rows_below(lines: list[list[str]], number: int, width: int) -> list[tuple[int, list[str]]]:
    """The rows of a table below its header, line ``number``, up to the first line of another width.

    A missing last cell is empty, and so is a number that the instrument did not know (NaN).
    """
    rows = []
    for line, whole in enumerate(lines[number:], start=number + 1):
        cells = _without_comment(whole, width)
        if not any(cells):
            continue
        if not width - 1 <= len(cells) <= width:
            break
        known = ["" if cell.lower() == "nan" else cell for cell in cells]
        rows.append((line, known + [""] * (width - len(cells))))
    return rows


def _load_rows(
    path: str | Path, header: list[str], ours: list[str], rows: list[tuple[int, list[str]]], load: int
) -> pd.DataFrame:
    """The loads in a column of rows, with the first columns of friction and of frames."""
    kinds = [name.partition("_")[0] for name in ours]
    chosen = {"load": load} | {kind: kinds.index(kind) for kind in ("friction", "frame") if kind in kinds}
    named = {k: _in_schema(ours[k], LOADS) for k in chosen.values()}
    table = _converted(path, rows, {name: (k, size) for k, (name, size) in named.items()}, LOADS)
    said = [f"{kind}{'s' * (kind != 'friction')} from {header[k]!r}" for kind, k in chosen.items()]
    if "frame" not in chosen:
        table["frame"] = [f"#{k + 1}" for k in range(len(rows))]
        said.append("one row a frame in their order")
    table.attrs["columns"] = ", ".join(said)
    return table


# --- the tables of a run

TableFormat = Literal["csv", "parquet"]
"""How the tables of a run are written. Parquet, for runs whose CSV files would be large, needs pyarrow."""

FORMATS: tuple[str, ...] = get_args(TableFormat)


def encoded_rows(rows: pd.DataFrame, schema: Schema, table_format: TableFormat = "csv") -> str | pd.DataFrame:
    """Rows of a table as a file has them: made in any process, written in one by a `TableWriter`.

    Text of CSV, or columns for Parquet; `InputError` if they do not fit the schema.
    """
    whole = schema.conform(rows)
    if table_format == "parquet":
        return whole
    if "flags" in whole:
        whole["flags"] = flag_names(whole["flags"])
    return str(whole.to_csv(header=False, index=False, lineterminator="\n"))


class TableWriter:
    """A table of a run to which rows are added.

    Parameters
    ----------
    schema : Schema
    folder : Path
        A folder that only counts when all of its files are complete (`contactimg.files.OutputFolder`).
    table_format : {"csv", "parquet"}
        Of Parquet, each addition is a row group.

    Attributes
    ----------
    empty : bool
        Whether no row was written.

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, schema: Schema, folder: Path, table_format: TableFormat = "csv") -> None:
        self.path, self.empty = folder / f"{schema.name}.{table_format}", True
        with explaining(self.path, "written"):
            if table_format == "csv":
                self._file: Any = self.path.open("w", encoding="utf-8", errors="surrogateescape", newline="")
                self._file.write(",".join(schema.columns) + "\n")
            else:
                self._arrow, parquet = _pyarrow()
                self._columns = self._arrow.Schema.from_pandas(schema.empty(), preserve_index=False)
                self._file = parquet.ParquetWriter(self.path, self._columns)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()

    def append(self, rows: str | pd.DataFrame) -> None:
        """Add the `encoded_rows` of this schema and format."""
        try:
            if isinstance(rows, str):
                self._file.write(rows)
                self._file.flush()
            else:
                table = self._arrow.Table.from_pandas(rows, schema=self._columns, preserve_index=False)
                self._file.write_table(table)
        except (OSError, ValueError) as error:  # also of a name that the format cannot hold
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{self.path}: cannot be written ({reason})") from None
        self.empty &= not len(rows)


def table_file(folder: Path, schema: Schema) -> Path:
    """The file of a table of a run: the CSV file unless there is only the other one."""
    first, *others = (folder / f"{schema.name}.{ending}" for ending in FORMATS)
    return next((path for path in others if path.is_file() and not first.is_file()), first)


def main_tables(folders: Iterable[Path]) -> list[Path]:
    """The tables of runs that other results are derived from."""
    return [table_file(Path(folder), schema) for folder in folders for schema in (CONTACTS, FRAMES)]


def read_run_table(folder: Path, schema: Schema, *, optional: bool = False) -> pd.DataFrame:
    """Read a table of a run; its numbers may be infinite.

    Parameters
    ----------
    folder : Path
    schema : Schema
        Columns that a later version added may be missing in the file, others in it are ignored.
    optional : bool
        Whether a table that is not there is empty.

    Raises
    ------
    InputError
        With the file, and where possible the line and column of what is not valid.
    """
    path = table_file(folder, schema)
    if optional and not path.is_file():
        return schema.empty()
    if path.suffix == ".csv":
        return read_table(path, schema, infinite=True)
    parquet, data = _pyarrow()[1], io.BytesIO(read_bytes(path))
    try:
        table = parquet.read_table(data).to_pandas()
    except Exception as error:  # whatever a damaged file makes of the decoder
        raise InputError(f"{path}: is not a Parquet file ({str(error)[:100]}); repeat the run") from None
    for name in schema.first:
        if name not in table:
            raise InputError(f"{path}: column {name} is missing; repeat the run")
    with naming(path):
        found = schema.conform(table[[name for name in schema.columns if name in table]])
    return found.fillna(dict.fromkeys(found.select_dtypes("str"), ""))


def require_format(table_format: TableFormat) -> None:
    """Raise an `InputError` if tables cannot be written in this format, before any work is done."""
    if table_format == "parquet":
        _pyarrow()


def _pyarrow() -> tuple[Any, Any]:
    """The modules of pyarrow, or an `InputError` that says how to get them."""
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError("Parquet tables need pyarrow, which is not installed; pip install pyarrow") from None
