"""Read and write files; no other room touches them.

In: frames, scenes, tables and calibrations. Out: tables, frames, figures and output folders.

Read in this order: `experiment` (a scene and the files it names), `sources` (frames of any format, decoded
by `tiff` and `decoders`), `csv_tables`, `run_tables` (CSV or Parquet), `output` (the folder of a run, its
provenance, and how it replaces the earlier one), `part_store` (results of a run that was ended), `runs`
(reading a run back), `calibrations`, `atomic` and `figures`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
