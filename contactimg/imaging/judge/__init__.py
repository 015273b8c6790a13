"""A second look at what was measured, and what it means for the frame.

In: the foreground, the difference image and the `contactimg.imaging.reject.detections.Detections` of either
method. Out: a `status.Verdict`.

Read `review` first (what is rejected and flagged), then `second_opinion` (areas without a model of the edge),
`agreement` (with the fit), `background_left`, and `status`.
"""
