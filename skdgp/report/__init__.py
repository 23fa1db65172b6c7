"""The report of an identification: one HTML file to read, print and sign.

Fill a `ReportContent` with arrays and pass it to `write_report`. The report neither fits nor predicts.
"""

from skdgp.report._content import FlightRecord, FlightResult, ModelSummary, ReportContent
from skdgp.report._write import render_report, write_report

__all__ = ["FlightRecord", "FlightResult", "ModelSummary", "ReportContent", "render_report", "write_report"]
