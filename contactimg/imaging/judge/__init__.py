"""A second look at what was measured, and what it means for the frame.

In: the foreground, the difference image and the `contactimg.imaging.reject.detections.Detections` of either
method. Out: a `status.Verdict`.

Read `second_opinion` first (areas without a model of the edge), then `status`.
"""
