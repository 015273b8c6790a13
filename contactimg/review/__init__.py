"""A local page on which the contacts of a run are checked and corrected by hand.

In: the output folder of `process`. Out: rows of edits.csv and, if chosen, a threshold in the scene file;
nothing else is written. Read in this order: `session` (what is reviewed, and its state), `jobs` (measuring
again), `shown_tables`, `frame_view` (what a frame shows), `requests` (what the page may ask for), `server`
(who may ask). The page is page.html, page.js and page.css.
"""

from contactimg.review.server import ReviewServer
from contactimg.review.session import Session

__all__ = ["ReviewServer", "Session"]
