"""Write one self-contained HTML page about a run.

In: the output folder of a run. Out: HTML text. Read in this order: `page` (the page), `summary` (its words);
the template is ``page.html.j2``.
"""

from contactimg.report.page import build_report

__all__ = ["build_report"]
