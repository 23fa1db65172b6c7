"""The report of an identification: one HTML file to read, print and sign."""

from skdgp.report._page import render_report, save_report

__all__ = ["render_report", "save_report"]
