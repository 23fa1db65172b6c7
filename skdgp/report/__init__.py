"""The report of an identification: one HTML file to read, print and sign.

`skdgp.identification.Identification` fills a `ReportContent`; nothing here fits or predicts.
"""

from skdgp.report._content import (
    THRESHOLDS,
    Evaluation,
    Extent,
    FlightMechanics,
    ReportContent,
    Use,
    Verdict,
    scores,
)
from skdgp.report._page import render_report
from skdgp.report._record import FitRecord, TrainingRecord

__all__ = [
    "THRESHOLDS",
    "Evaluation",
    "Extent",
    "FitRecord",
    "FlightMechanics",
    "ReportContent",
    "TrainingRecord",
    "Use",
    "Verdict",
    "render_report",
    "scores",
]
