"""Everything known of each candidate in one table, and the rules that keep, flag or reject it.

`rules` decides on each candidate, `reference_dust` finds what dust of the reference looks like one, `status`
decides on the frame.
"""
