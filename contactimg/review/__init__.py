"""A local page on which the contacts of a run are checked and corrected by hand.

In: the output folder of `process`. Out: rows of edits.csv and, if chosen, a threshold in the scene file;
nothing else is written. Read in this order: `session` (what is reviewed, its state, and the tables that are
shown), `jobs` (measuring again), `frame_view` (what a frame shows), `server` (who may ask for what). The page
is page.html, page.js and page.css.
"""

from contactimg.review.server import ReviewServer
from contactimg.review.session import Session

__all__ = ["ReviewServer", "Session"]
