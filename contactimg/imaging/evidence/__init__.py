"""Everything known of each candidate in one table, and the rules that keep, flag or reject it.

`rules` decides on each candidate, `status` on the frame.
"""
