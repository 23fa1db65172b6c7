"""The report as one HTML file."""

from __future__ import annotations

import os
from datetime import datetime
from importlib.resources import files
from pathlib import Path

from skdgp._compute.files import text_writer, write_atomically
from skdgp._display.html import can_draw, render_page, text
from skdgp._display.style import units_shown
from skdgp.report import _sections as sections
from skdgp.report._charts import thinning
from skdgp.report._content import ReportContent

SCRIPT = files("skdgp.report").joinpath("chart.js").read_text(encoding="utf-8")


def write_report(path: str | os.PathLike, content: ReportContent) -> Path:
    """Write a report as one HTML file that needs nothing else, no network, no other file; return its path.

    The file appears whole or not at all. It holds pictures as they are printed; on a screen its script makes charts of
    them, to zoom and to read values. Without matplotlib the report has no pictures and says so. Raises
    FileNotFoundError if the folder does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.report import ReportContent, write_report
    >>> path = write_report(Path(tempfile.mkdtemp()) / "report.html", ReportContent(title="Brumby, first flights"))
    >>> path.read_text(encoding="utf-8").splitlines()[0]
    '<!DOCTYPE html>'
    """
    return write_atomically(path, text_writer(render_report(content)))


def render_report(content: ReportContent) -> str:
    """Return the report as one HTML document."""
    aircraft = content.aircraft if isinstance(content.aircraft, str) else content.aircraft.get("Aircraft", "")
    created = datetime.now().astimezone() if content.created is None else content.created
    flights = f"flights: {len(content.train)} training, {len(content.test)} test"
    meta = " · ".join(text(part) for part in (aircraft, flights, f"{created:%d %B %Y, %H:%M}") if part)
    made = text(f"Made by skdgp {content.model.versions.get('skdgp', '')}".rstrip())
    colophon = f"{made}. SI units; degrees in pictures and in the table of states."
    with units_shown(content.units):
        return render_page(
            "Aerodynamic identification report", content.title, meta, _body(content), colophon, script=SCRIPT
        )


def _body(content: ReportContent) -> str:
    draw, every = can_draw(), thinning(content)
    parts = [sections.verdict(content), sections.assumed(content), sections.messages(content)]
    if content.mechanics is not None:
        parts.append(sections.mechanics(content.mechanics))
    parts.append(sections.what_was_done(content))
    if not draw:
        parts.append('<p class="note">No pictures: they need matplotlib, pip install "skdgp[plot]".</p>')
    parts += content.sections
    parts += sections.flights(content, every, draw)
    if draw and content.test:
        parts.append(sections.calibration(content))
    if draw and content.effects is not None:
        parts.append(sections.effects(content.effects))
    if draw and content.envelope is not None:
        parts.append(sections.envelope(content.envelope))
    if sections.flown_tables(content):
        parts.append(sections.flown(content, every, draw))
    return "\n".join([*parts, sections.how_to_read()])
