"""Read and write files; no other room touches them.

In: frames, scenes, tables and calibrations. Out: tables, frames, figures and output folders.

Read in this order: `experiment` (a scene and the files it names), `sources` (frames of any format),
`decoders` (their pixels), `corrections` (of pixels and contacts), `tables` (CSV or Parquet), `resume` (the
parts of a run that lasts), `output` (the folder of a run, its provenance, and how it replaces the earlier
one), `runs` (reading results back), `exports` (for other programs), `height_maps`, `atomic` and `figures`.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
