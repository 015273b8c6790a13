"""The chains: measure a frame, a series; predict; simulate; compare."""
