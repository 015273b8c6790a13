"""One self-contained HTML page of a run."""

from contactimg.report.page import build_report

__all__ = ["build_report"]
