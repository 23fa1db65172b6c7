"""The report as one HTML file: page, style and script."""

from __future__ import annotations

import base64
import hashlib
import os
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from string import Template

from skdgp._compute.files import write_atomically
from skdgp.plotting._style import check_matplotlib
from skdgp.report import _sections as sections
from skdgp.report._charts import thinning
from skdgp.report._content import ReportContent
from skdgp.report._pictures import time_slices
from skdgp.report._sections import Detail
from skdgp.report._tables import text

_HERE = files("skdgp.report")
STYLE = _HERE.joinpath("report.css").read_text(encoding="utf-8")
SCRIPT = _HERE.joinpath("chart.js").read_text(encoding="utf-8")
_DIGEST = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
POLICY = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{_DIGEST}'"
"""The browser allows this script and nothing else: no other file, no network."""
PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="$policy">
<meta name="generator" content="skdgp">
<title>$title</title>
<style>$style</style>
</head>
<body>
<main>
<header>
<p class="kind">Aerodynamic identification report</p>
<h1>$title</h1>
<p class="meta">$meta</p>
</header>
$body
<footer>
<p class="colophon">$colophon</p>
</footer>
</main>
<script>$script</script>
</body>
</html>
""")


def write_report(path: str | os.PathLike, content: ReportContent) -> Path:
    """Write a report as one HTML file that needs nothing else: no network, no other file.

    The file appears whole or not at all. It holds pictures as they are printed; on a screen its script makes charts of
    them, to zoom and to read values. Without matplotlib the report has no pictures and says so.

    Parameters
    ----------
    path : path-like
        Where to write, such as ``report.html``; its folder must exist.
    content : ReportContent
        What to show.

    Returns
    -------
    Path
        ``path``.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.report import ReportContent, write_report
    >>> path = write_report(Path(tempfile.mkdtemp()) / "report.html", ReportContent(title="Brumby, first flights"))
    >>> path.read_text(encoding="utf-8").splitlines()[0]
    '<!DOCTYPE html>'
    """
    page = render_report(content)
    return write_atomically(path, lambda temporary: temporary.write_text(page, encoding="utf-8"))


def render_report(content: ReportContent) -> str:
    """Return the report as one HTML document."""
    title = text(content.title)
    return PAGE.substitute(
        title=title,
        policy=POLICY,
        style=STYLE,
        meta=_meta(content),
        body=_body(content),
        colophon=_colophon(content),
        script=SCRIPT,
    )


def _body(content: ReportContent) -> str:
    draw = _can_draw()
    parts = [sections.summary(content), sections.messages(content), sections.what_was_done(content)]
    if not draw:
        parts.append('<p class="note">No pictures: they need matplotlib, pip install "skdgp[plot]".</p>')
    detail = Detail(time_slices(len(content.test)), thinning(content))
    parts += [sections.flight(result, content.model.noise_std, detail, draw) for result in content.test]
    if draw and content.effects is not None:
        parts.append(sections.effects(content.effects))
    if draw and content.model.correlation is not None:
        parts.append(sections.coupling(content))
    if draw and content.envelope is not None:
        parts.append(sections.envelope(content.envelope))
    if draw and sections.flown_tables(content):
        parts.append(sections.flown(content, detail))
    return "\n".join([*parts, sections.how_to_read()])


def _can_draw() -> bool:
    try:
        check_matplotlib("write_report")
    except ImportError:
        return False
    return True


def _meta(content: ReportContent) -> str:
    aircraft = content.aircraft if isinstance(content.aircraft, str) else content.aircraft.get("Aircraft", "")
    flights = f"{len(content.train)} training, {len(content.test)} test"
    created = datetime.now().astimezone() if content.created is None else content.created
    parts = [aircraft, f"flights: {flights}", f"{created:%d %B %Y, %H:%M}"]
    return " · ".join(text(part) for part in parts if part)


def _colophon(content: ReportContent) -> str:
    version = content.model.versions.get("skdgp")
    made = f"skdgp {version}" if version else "skdgp"
    return f"Made by {text(made)}. SI units; degrees in pictures and in the table of states."
