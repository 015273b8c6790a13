"""Brightness against the distance from the rim of a contact, and the optics behind it."""
