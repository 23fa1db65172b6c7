"""The skeleton of a page: one HTML file with its style, and a script where it needs one."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from importlib.util import find_spec
from string import Template

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
<p class="kind">$kind</p>
<h1>$title</h1>
<p class="meta">$meta</p>
</header>
$body
<footer>
<p class="colophon">$colophon</p>
</footer>
</main>
$script
</body>
</html>
""")


def render_page(kind: str, title: str, meta: str, body: str, colophon: str, *, script: bool = True) -> str:
    """Return the document; title and kind are text, the rest is HTML."""
    words = {"kind": text(kind), "title": text(title), "meta": meta, "body": body, "colophon": colophon}
    return PAGE.substitute(words, policy=POLICY, style=STYLE, script=f"<script>{SCRIPT}</script>" if script else "")


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None
