"""Labelled regions of a difference image: `labelled_regions` tells bars from disks by their inscribed circles.
"""
