"""The calibrations of a folder of frames."""
