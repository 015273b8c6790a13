"""The method "threshold": contacts as the pixels above a fraction of the contrast.

In: the foreground of a frame (`contactimg.imaging.reject.foreground.Foreground`) and a threshold. Out: the
`Detections` that the method "disk" returns as well.

Read `method` first (the whole method and a table of its constants), then `threshold` (which fraction),
`split_touching` (components that are several contacts) and `expected_error` (what the method gets wrong on a
frame).
"""
