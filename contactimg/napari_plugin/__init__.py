"""Plugin for napari: opens a run folder as layers and writes what was corrected on them as edits.csv.

`napari.yaml` tells napari what there is. The plugin imports neither napari nor Qt.
"""
