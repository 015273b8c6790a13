"""Closed forms of contact mechanics: no files, no images."""

from contactimg.mechanics import hertz, jkr, sphere

__all__ = ["hertz", "jkr", "sphere"]
