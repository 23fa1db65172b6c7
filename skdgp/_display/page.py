"""The skeleton of a page: one HTML file with its style, and a script where it needs one."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from importlib.util import find_spec
from string import Template

from skdgp._display.html import text

STYLE = files("skdgp._display").joinpath("page.css").read_text(encoding="utf-8")
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'"
"""The browser allows the page's own script and nothing else: no other file, no network."""
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


def render_page(kind: str, title: str, meta: str, body: str, colophon: str, *, script: str = "") -> str:
    """Return the document; title and kind are text, ``script`` is JavaScript, the rest is HTML."""
    policy = POLICY.format(base64.b64encode(hashlib.sha256(script.encode()).digest()).decode())
    script = f"<script>{script}</script>" if script else ""
    words = {"kind": text(kind), "title": text(title), "meta": meta, "body": body, "colophon": colophon}
    return PAGE.substitute(words, policy=policy, style=STYLE, script=script)


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None
