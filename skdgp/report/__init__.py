"""The report of an identification: one HTML file to read, print and sign.

`skdgp.identification.Identification` fills a `ReportContent`; nothing here fits or predicts.
"""

from skdgp.report._content import (
    THRESHOLDS,
    Evaluation,
    FlightMechanics,
    ReportContent,
    Use,
    Verdict,
    scores,
)
from skdgp.report._page import render_report

__all__ = [
    "THRESHOLDS",
    "Evaluation",
    "FlightMechanics",
    "ReportContent",
    "Use",
    "Verdict",
    "render_report",
    "scores",
]
