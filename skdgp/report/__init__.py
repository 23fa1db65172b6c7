"""The report of an identification: one HTML file to read, print and sign.

Fill a `ReportContent` with arrays and pass it to `write_report`, which neither fits nor predicts.
"""

from skdgp.report._content import (
    THRESHOLDS,
    FlightMechanics,
    FlightResult,
    ReportContent,
    Use,
    Verdict,
)
from skdgp.report._page import render_report, write_report

__all__ = [
    "THRESHOLDS",
    "FlightMechanics",
    "FlightResult",
    "ReportContent",
    "Use",
    "Verdict",
    "render_report",
    "write_report",
]
