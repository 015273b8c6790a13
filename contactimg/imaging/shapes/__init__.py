"""Shapes in an image: components, objects, inscribed disks, arcs, peaks, overlaps."""
