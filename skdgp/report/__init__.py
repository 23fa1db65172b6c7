"""The report of an identification: one HTML file to read, print and sign.

`skdgp.identification.Identification` fills a `ReportContent`; nothing here fits or predicts.
Names imported as themselves are not part of the public interface: findings, of which verdicts consist.
"""

from skdgp._compute.findings import Code as Code
from skdgp._compute.findings import Finding as Finding
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
