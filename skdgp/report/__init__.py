"""The report of an identification and the card of a planned flight: each one HTML file to read, print and sign.

Fill a `ReportContent` with arrays and pass it to `write_report`; pass a plan to `write_flight_card`. Both neither fit
nor predict.
"""

from skdgp.report._card import write_flight_card
from skdgp.report._content import (
    THRESHOLDS,
    FlightMechanics,
    FlightResult,
    ModelSummary,
    ReportContent,
    Use,
    Verdict,
)
from skdgp.report._write import render_report, write_report

__all__ = [
    "THRESHOLDS",
    "FlightMechanics",
    "FlightResult",
    "ModelSummary",
    "ReportContent",
    "Use",
    "Verdict",
    "render_report",
    "write_flight_card",
    "write_report",
]
