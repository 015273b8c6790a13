"""CSV: what is accepted, one sentence with line and column for what is not, and every digit kept."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contactimg import Flag, InputError
from contactimg.files import read_asperities, read_loads, read_table, write_table
from contactimg.tables import ASPERITIES, CONTACTS, FRAMES, LOADS, REJECTED

SCHEMAS = [ASPERITIES, CONTACTS, FRAMES]  # between them every kind of column


def loads_of(tmp_path, content, *, name="loads.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_loads(path)


def refusal(tmp_path, content, read=loads_of):
    """The sentence without the path in front."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, content)
    sentence = str(caught.value)
    assert sentence.startswith(f"{tmp_path / 'loads.csv'}: ")
    assert "\n" not in sentence
    return sentence.removeprefix(f"{tmp_path / 'loads.csv'}: ")


def asperities_of(tmp_path, content):
    (tmp_path / "loads.csv").write_text(content)
    return read_asperities(tmp_path / "loads.csv")


# ---------------------------------------------------------------- accepted


@pytest.mark.parametrize(
    "content",
    [
        "frame,load_N\na.tif,0.02\nb.tif,0.5\n",
        "frame,load_N\r\na.tif,0.02\r\nb.tif,0.5",
        "\ufefframe,load_N\na.tif,0.02\nb.tif,0.5\n".replace("\ufeffr", "\ufefffr"),
        "\n\nframe,load_N\n\na.tif,0.02\n , \nb.tif,0.5\n\n",
        "frame;load_N\na.tif;0,02\nb.tif;0,5\n",
        "frame;load_N\na.tif;0.02\nb.tif;0.5\n",
        "frame\tload_N\na.tif\t0,02\nb.tif\t5e-1\n",
        " frame , load_N \n a.tif , 0.02 \n b.tif , 0.5 \n",
        'load_N,comment,frame\n0.02,"slow, dry",a.tif\n0.5,,b.tif\n',
        "Frame,LOAD_N\na.tif,0.02\nb.tif,0.5\n",
        "frame,load_N,temp µ\n".encode("cp1252") + b"a.tif,0.02,1\nb.tif,0.5,2\n",
        "frame,load_N\na.tif,0.02,\nb.tif,0.5, ,\n",
        "# monday\nframe,load_N\na.tif,0.02 # read twice, by hand\n# c.tif,0.9\n#d.tif,1\nb.tif,0.5,# 3\n#\n",
        "# frame,load_N,friction_N\na.tif,0.02 # was 0.03, 0.04\nb.tif,0.5,\n",
        "Bild\tKraft [N]\na.tif\t0,02 # 7\n# c.tif\t3\nb.tif\t0,5\t# 8\n",
        "frame Load(N)\na.tif 0.02 # 7\nb.tif 0.5 #8\n# c.tif 7\n",
    ],
    ids=[
        "plain",
        "CRLF",
        "BOM",
        "blanks",
        "Excel",
        "semicolons",
        "tabs",
        "spaces",
        "extra",
        "capitals",
        "cp1252",
        "empty cells",
        "comments",
        "comment before cells",
        "comments behind tabs",
        "comments behind blanks",
    ],
)
def test_ways_to_write_the_same_loads(tmp_path, content):
    loads = loads_of(tmp_path, content)
    assert list(loads) == list(LOADS.columns)
    assert loads["frame"].tolist() == ["a.tif", "b.tif"]
    assert loads["load_N"].tolist() == [0.02, 0.5]
    assert loads["friction_N"].isna().all()
    assert {name: str(dtype) for name, dtype in loads.dtypes.items()} == {
        name: dtype for name, (dtype, _) in LOADS.columns.items()
    }


def test_a_number_sign_in_a_name_is_no_comment(tmp_path):
    loads = loads_of(tmp_path, "frame,load_N\nimg #3.tif,0.02\n#4,0.5 # by number\n")
    assert loads["frame"].tolist() == ["img #3.tif", "#4"]
    assert loads["load_N"].tolist() == [0.02, 0.5]
    loads = loads_of(tmp_path, "Bild\tKraft [N]\nimg #3.tif\t0,02\n")
    assert loads["frame"].tolist() == ["img #3.tif"]
    assert "line 2 has 3 cells" in refusal(tmp_path, "frame,load_N\na.tif,0,5 # decimals\n")


def test_columns_that_are_not_read_are_named(tmp_path):
    loads = loads_of(tmp_path, "frame,load_N,fricton_N,time_ms\na.tif,0.02,1,2\n")
    assert loads.attrs["remark"] == (
        "not read: 'fricton_N', 'time_ms'; it may also hold friction_N, velocity_m_s, tangential_N, time_s"
    )
    for end in ("", ",", ", "):
        assert "remark" not in loads_of(tmp_path, f"frame,load_N{end}\na.tif,0.02{end}\n").attrs


def test_optional_columns_are_kept(tmp_path):
    loads = loads_of(tmp_path, "frame,load_N,velocity_m_s,friction_N\na.tif,0.02,1e-4,\n")
    assert loads["velocity_m_s"].tolist() == [1e-4]
    assert np.isnan(loads["friction_N"][0])


def test_header_alone_is_an_empty_table(tmp_path):
    loads = loads_of(tmp_path, "frame,load_N\n")
    assert (len(loads), list(loads)) == (0, list(LOADS.columns))
    assert str(loads["load_N"].dtype) == "float64"


def test_asperities(tmp_path):
    table = asperities_of(
        tmp_path,
        "x_m,y_m,height_m,radius_m,kind\n# drawn\n1e-3,2e-3,4e-5,1e-4 # cut,cap\n0,0,-1e-5,2e-4,\n",
    )
    assert list(table) == list(ASPERITIES.first)
    np.testing.assert_array_equal(table.to_numpy(), [[1e-3, 2e-3, 4e-5, 1e-4], [0, 0, -1e-5, 2e-4]])


def test_long_tables_are_read_in_blocks(tmp_path):
    count = 50_010  # more rows than are converted at once
    lines = [f"f{k}.tif,{k / 7!r}" for k in range(count)]
    loads = loads_of(tmp_path, "frame,load_N\n" + "\n".join(lines))
    assert loads["load_N"].tolist() == [k / 7 for k in range(count)]
    assert loads.index.tolist() == list(range(count))
    lines[50_003] = "f50003.tif,x"
    sentence = refusal(tmp_path, "frame,load_N\n" + "\n".join(lines))
    assert sentence == "line 50005, column load_N must be a number, got 'x'"


# ---------------------------------------------------------------- refused


NO_TEXT = "not text; save the table as 'CSV UTF-8' and name that file"
NO_UNIT = "no column is a load with its unit, such as load_mN, load_g, Kraft [mN] or Load (N)"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (
            "frame,load\na,1\n",
            (
                "column load_N is missing; the header must name frame, load_N, got frame, load; "
                f"{NO_UNIT}; the columns are frame, load"
            ),
        ),
        ("", "column frame is missing; the header must name frame, load_N, got nothing; " + NO_UNIT),
        ("frame,load_N,load_N\na,1,2\n", "column load_N occurs 2 times (load_N, load_N); keep one"),
        ("frame,load_N\na,1\n\nb,0.1 N\n", "line 4, column load_N must be a number, got '0.1 N'"),
        ("frame,load_N\na,1_000\n", "line 2, column load_N must be a number, got '1_000'"),
        ("frame;load_N\na;1.234,5\n", "line 2, column load_N must be a number, got '1.234,5'"),
        ("frame,load_N\na,nan\n", "line 2, column load_N must be a finite number, got 'nan'"),
        ("frame,load_N\na,-inf\n", "line 2, column load_N must be a finite number, got '-inf'"),
        ("frame,load_N\na,1e999\n", "line 2, column load_N must be a finite number, got '1e999'"),
        (
            "frame,load_N,friction_N\na,1,\nb,1,nan\n",
            "line 3, column friction_N must be a finite number, got 'nan'",
        ),
        (
            "frame,load_N,friction_N\na,1,inf\n",
            "line 2, column friction_N must be a finite number, got 'inf'",
        ),
        ("frame,load_N\na,\n", "line 2, column load_N must have a value, got ''"),
        ("frame,load_N\n ,1\n", "line 2, column frame must have a value, got ' '"),
        (
            "frame,load_N\na,1,2\n",
            "line 2 has 3 cells, but the header has 2 columns; decimal commas need semicolons between cells",
        ),
        ("frame;load_N\na;1;2\n", "line 2 has 3 cells, but the header has 2 columns"),
        ("frame,load_N\na\n", "line 2 has 1 cells, but the header has 2 columns"),
        (
            "frame,load_N\na,0.1\nb,-0.1\n",
            (
                "load_N of b must not be negative, got -0.1; "
                "only an adhesive contact (`calibrate jkr`) carries a negative load"
            ),
        ),
        ("frame,load_N\na,0.1\nb,0.2\na,0.3\n", "frame a is there more than once; keep one row"),
        (b"PK\3\4\0\0", f"is an Excel workbook or another zip file, {NO_TEXT}"),
        (b"II*\0\x08\0\0\0", f"is an image, {NO_TEXT}"),
        (b"\1\0\2\0frame,load_N", f"is a binary file, {NO_TEXT}"),
    ],
)
def test_loads_that_are_refused(tmp_path, content, sentence):
    assert refusal(tmp_path, content) == sentence


def test_cell_without_end(tmp_path):
    content = "frame,load_N\na,1\nb," + "9" * 200_000 + "\n"
    assert refusal(tmp_path, content) == "line 3 is not CSV (field larger than field limit (131072))"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (
            "x_m,y_m,height_m\n0,0,1e-5\n",
            (
                "column radius_m is missing; the header must name x_m, y_m, height_m, radius_m, "
                "got x_m, y_m, height_m"
            ),
        ),
        ("x_m,y_m,height_m,radius_m\n", "the table has no row; it needs at least one asperity"),
        ("x_m,y_m,height_m,radius_m\n0,0,,1e-4\n", "line 2, column height_m must have a value, got ''"),
        (
            "x_m,y_m,height_m,radius_m\n0,0,1e-5,1e-4\n0,1e-3,1e-5,0\n",
            "asperities: row 1, column 'radius_m' must be positive, got ",
        ),
        (
            "x_m,y_m,height_m,radius_m\n0,0.5,1e-5,1e-4\n0,0.5,2e-5,1e-4\n",
            "x_m, y_m 0.0, 0.5 is there more than once; keep one row",
        ),
        (
            "x_m,y_m,height_m,radius_m\n0,0,4e-5,1e-4\n1,1,40,100\n",
            (
                "asperities: row 1, column 'height_m' must be metres, at most 0.01, got 40.0; "
                "is it in another unit?"
            ),
        ),
    ],
)
def test_asperities_that_are_refused(tmp_path, content, sentence):
    assert refusal(tmp_path, content, asperities_of).startswith(sentence)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"loads\.csv: cannot be read \(No such file or directory\)$"):
        read_loads(tmp_path / "loads.csv")


NO_FLAG = f"must hold names of flags ({', '.join(Flag.__members__)}) joined by |, got 'EDGE|ROUND'"


@pytest.mark.parametrize(
    ("cell", "column", "sentence"),
    [
        ("1.5", "label", "line 2, column label must be a whole number, got '1.5'"),
        ("one", "label", "line 2, column label must be a number, got 'one'"),
        ("EDGE|ROUND", "flags", f"line 2, column flags {NO_FLAG}"),
        ("inf", "x_m", "line 2, column x_m must be a finite number, got 'inf'"),
    ],
)
def test_contacts_that_are_refused(tmp_path, cell, column, sentence):
    cells = dict.fromkeys(CONTACTS.columns, "") | {"frame": "a.tif", column: cell}

    def read(folder, content):
        (folder / "loads.csv").write_text(content)
        return read_table(folder / "loads.csv", CONTACTS)

    content = ",".join(cells) + "\n" + ",".join(cells.values()) + "\n"
    assert refusal(tmp_path, content, read) == sentence


def test_whole_numbers_that_a_spreadsheet_wrote_with_decimals(tmp_path):
    given_cells = {"frame": "a.tif", "label": "3.0", "asperity": "1e2"}
    cells = dict.fromkeys(CONTACTS.columns, "") | given_cells
    (tmp_path / "c.csv").write_text(",".join(cells) + "\n" + ",".join(cells.values()) + "\n")
    table = read_table(tmp_path / "c.csv", CONTACTS)
    assert (table["label"].tolist(), table["asperity"].tolist(), table["flags"].tolist()) == ([3], [100], [0])


# ---------------------------------------------------------------- written and read back

# a carriage return alone is a line end to every reader of CSV, so a name with one does not survive; NUL marks
# a file that is no text
TEXT = st.text(st.characters(exclude_characters="\0\r", exclude_categories=["Cs"]), max_size=12)
NUMBER = st.floats(allow_nan=False) | st.just(float("nan"))
COUNT = st.integers(-(2**63), 2**63 - 1) | st.just(pd.NA)
CELLS = {
    "str": TEXT,
    "float64": NUMBER,
    "Int64": COUNT,
    "int64": st.integers(0, sum(Flag)),
}


def rows_of(schema):
    cells = {name: CELLS[dtype] for name, (dtype, _) in schema.columns.items()}
    if "frame" in cells:
        cells["frame"] = TEXT.filter(lambda text: text.strip())  # a row without any value is a blank line
    else:
        cells[next(iter(cells))] = st.floats(allow_nan=False)
    return st.lists(st.fixed_dictionaries(cells), max_size=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


def test_the_table_of_a_run_has_no_comments(tmp_path):
    """A frame may be called #a.tif or a # b.tif."""
    rows = {"frame": ["1.tif", "#a.tif", "a # b.tif"], "x_px": 1.0, "y_px": 2.0}
    table = REJECTED.conform(pd.DataFrame(rows))
    write_table(table, REJECTED, tmp_path / "t.csv")
    pd.testing.assert_frame_equal(read_table(tmp_path / "t.csv", REJECTED), table)


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.name)
def test_tables_survive_the_file_bit_by_bit(folder, schema):
    @settings(max_examples=30, deadline=None)
    @given(rows_of(schema))
    def check(rows):
        table = schema.conform(pd.DataFrame(rows)) if rows else schema.empty()
        write_table(table, schema, folder / "t.csv")
        again = read_table(folder / "t.csv", schema, infinite=True)
        pd.testing.assert_frame_equal(again, table, check_exact=True, check_index_type=False)
        for name in again.select_dtypes("float64"):  # -0.0 too
            np.testing.assert_array_equal(np.signbit(again[name]), np.signbit(table[name]))

    check()


def test_file_as_a_person_sees_it(folder):
    flags = [0, Flag.EDGE | Flag.MERGED]
    table = pd.DataFrame(
        {"frame": ['a,"1".tif', "b.tif"], "label": [1, pd.NA], "x_px": [0.1, np.nan], "flags": flags}
    )
    write_table(table, CONTACTS, folder / "c.csv")
    header, first, second = (folder / "c.csv").read_bytes().decode().splitlines()
    assert header == ",".join(CONTACTS.columns)
    names = list(CONTACTS.columns)
    before = names.index("flags")
    after = len(names) - 1 - before
    assert first == '"a,""1"".tif",1,0.1' + "," * (len(names) - 3)
    assert second == "b.tif" + "," * before + "EDGE|MERGED" + "," * after
    assert [path.name for path in folder.iterdir() if path.suffix == ".part"] == []


def test_file_name_that_is_not_utf8_survives(folder):
    name = b"caf\xe9.tif".decode(errors="surrogateescape")
    write_table(pd.DataFrame({"frame": [name], "load_N": [1.0]}), LOADS, folder / "l.csv")
    assert read_loads(folder / "l.csv")["frame"].tolist() == [name]


def test_a_table_with_all_columns_keeps_its_values_alone():
    given = LOADS.conform({"frame": ["a", "b"], "load_N": [0.1, 0.2]}).set_index(pd.Index([3, 5]))
    given.attrs["note"] = "of the table that was given"
    found = LOADS.conform(given)
    assert found.index.equals(pd.RangeIndex(2))
    assert found.attrs == {}
    found.loc[0, "load_N"] = 0.3
    assert given["load_N"].tolist() == [0.1, 0.2]
    assert found["load_N"].tolist() == [0.3, 0.2]
    empty = LOADS.empty()
    empty["more"] = 1
    assert list(LOADS.empty().columns) == list(LOADS.columns)


def test_table_that_does_not_fit_is_not_written(folder):
    with pytest.raises(InputError, match="unknown column 'load'"):
        write_table(pd.DataFrame({"frame": ["a"], "load": [1.0]}), LOADS, folder / "never.csv")
    assert not (folder / "never.csv").exists()


def test_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError) as caught:
        write_table(LOADS.empty(), LOADS, tmp_path / "no" / "loads.csv")
    path = tmp_path / "no" / "loads.csv"
    assert str(caught.value) == f"{path}: cannot be written (No such file or directory)"


def test_columns_in_other_units_are_converted(tmp_path):
    loads = tmp_path / "loads.csv"
    loads.write_text("frame,load_mN,velocity_um_s\na.tif,300,50\nb.tif,,\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 3, column load_N must have a value"):
        read_loads(loads)
    loads.write_text("frame,load_mN,velocity_um_s\na.tif,300,50\n", encoding="utf-8")
    (row,) = read_loads(loads).to_dict("records")
    assert (row["load_N"], row["velocity_m_s"]) == (0.3, 5e-5)
    asperities = tmp_path / "asperities.csv"
    asperities.write_text("x_um;y_mm;height_nm;radius_µm\n1000;2,5;3000;100\n", encoding="utf-8")
    (row,) = read_asperities(asperities).to_dict("records")
    assert list(row.values()) == [1e-3, 2.5e-3, 3e-6, 1e-4]


def test_the_same_column_in_two_units_is_refused(tmp_path):
    loads = tmp_path / "loads.csv"
    loads.write_text("frame,load_mN,load_N\na.tif,300,0.3\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"column load_N occurs 2 times \(load_mN, load_N\); keep one"):
        read_loads(loads)
