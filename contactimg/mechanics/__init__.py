"""Closed forms of contact mechanics: no files, no images."""
