"""The method "threshold": contacts as the pixels above a fraction of the contrast.

In: the foreground of a frame (`contactimg.imaging.foreground.Foreground`) and a threshold. Out: the columns
of contacts and rejected components that the method "disk" gives as well.

Read `method` first (the choice of the fraction, and the steps), then `split_touching` (components that are
several contacts), `rim_errors` (what the method gets wrong on a frame) and `by_hand` (corrections by hand).
"""
