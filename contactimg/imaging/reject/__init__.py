"""Reject what stands out of the background and is not a contact.

In: the difference image of a frame. Out: the `foreground.Foreground` that both methods measure, and for each
rejected candidate a `contactimg.tables.Reason`.

Read `foreground` first (noise, contrast, mask), then `foreign_objects` (bars, hairs, streaks, bright grains;
before the contacts are measured), `implausible_disks` and `reference_dust` (after), and `detections`, the
result that both methods return.
"""
