"""Take the background out of a frame."""
