"""Read and write files; no other room touches them.

In: frames, scenes, tables and calibrations. Out: tables, frames, figures and output folders.

Read in this order: `experiment` (a scene and the files it names), `sources` (frames of any format, decoded
by `tiff`, `stills`, `norpix`, `video`; colours by `grey`), `csv_tables`, `parquet_tables`, `run_tables`
(either of them), `output` (the folder of a run), `commit` (how it replaces the earlier one), `frame_store`
(frames of a run that was ended, as text by `records`), `runs` (its provenance), `calibrations`, `atomic`,
`signals` and `figures`.
"""

from contactimg.files.atomic import remove_leftovers, replacing, write_json, write_text
from contactimg.files.calibrations import CALIBRATION_FILE, read_calibration, shares_frames
from contactimg.files.commit import PROVENANCE_FILE, finish_commit
from contactimg.files.corrections import EVERY_FRAME
from contactimg.files.csv_tables import (
    read_asperities,
    read_loads,
    read_table,
    read_topography,
    write_table,
)
from contactimg.files.edit_rows import EditsFile
from contactimg.files.edits import EDITS_FILE, MASK, edit_points, read_edits, write_edits
from contactimg.files.experiment import (
    SCENE_FILE,
    Experiment,
    edits_file,
    is_reference,
    named_file,
    open_experiment,
    read_scene,
    read_scene_asperities,
    read_scene_loads,
    write_scene,
)
from contactimg.files.figures import figure_bytes, write_figure, write_figures, write_palette_image
from contactimg.files.frame_store import EncodedResult, FrameStore, KeyList, decode_part
from contactimg.files.output import OutputFolder
from contactimg.files.run_tables import (
    EncodedRows,
    TableFormat,
    TableWriter,
    main_tables,
    read_run_table,
    require_format,
)
from contactimg.files.runs import RunFolder, provenance, read_records, read_run
from contactimg.files.scene_edit import set_scene_keys
from contactimg.files.sources import FrameList, FrameSeries, FrameSource, list_frames, read_frames
from contactimg.files.table_hashes import RUN_TABLES
from contactimg.files.tiff import write_frame

__all__ = [
    "CALIBRATION_FILE",
    "EDITS_FILE",
    "EVERY_FRAME",
    "MASK",
    "PROVENANCE_FILE",
    "RUN_TABLES",
    "SCENE_FILE",
    "EditsFile",
    "EncodedResult",
    "EncodedRows",
    "Experiment",
    "FrameList",
    "FrameSeries",
    "FrameSource",
    "FrameStore",
    "KeyList",
    "OutputFolder",
    "RunFolder",
    "TableFormat",
    "TableWriter",
    "decode_part",
    "edit_points",
    "edits_file",
    "figure_bytes",
    "finish_commit",
    "is_reference",
    "list_frames",
    "main_tables",
    "named_file",
    "open_experiment",
    "provenance",
    "read_asperities",
    "read_calibration",
    "read_edits",
    "read_frames",
    "read_loads",
    "read_records",
    "read_run",
    "read_run_table",
    "read_scene",
    "read_scene_asperities",
    "read_scene_loads",
    "read_table",
    "read_topography",
    "remove_leftovers",
    "replacing",
    "require_format",
    "set_scene_keys",
    "shares_frames",
    "write_edits",
    "write_figure",
    "write_figures",
    "write_frame",
    "write_json",
    "write_palette_image",
    "write_scene",
    "write_table",
    "write_text",
]
