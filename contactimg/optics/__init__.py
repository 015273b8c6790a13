"""The light: what the optics make of a contact."""
