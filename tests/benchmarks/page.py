"""Bring the pages of benchmarks and of the comparison up to date: tables and pictures from the scripts' results.

    python tests/benchmarks/page.py FOLDER

FOLDER is what the scripts were given as --out. A table stands on the page between ``<!-- NAME:TABLE -->`` and
``<!-- end -->``, and is that TABLE of NAME.json; ``NAME:machine`` says where it was measured.
What has no results stays as it is.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.ticker import NullLocator

from skdgp._display.style import PALETTE, tidy

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = (
    *(
        "benchmarks.md",
        "comparison.md",
        "control.md",
        "design.md",
        "first_model.md",
        "results.md",
        "dynamics.md",
        "simulation.md",
    ),
    *("published.md", "study.md", "versions.md"),
)
COLOURS = {"skdgp": "blue", "LAPACK": "grey", "scikit-learn": "green", "GPyTorch": "vermillion", "GPy ": "purple"}
DASHES = {"exact": "--", "one thread": "--", "150": ":"}
COLOURS |= {"mogptk": "orange", "least": "grey"}


def main(folder, docs=DOCS):
    results = {path.stem: json.loads(path.read_text()) for path in sorted(Path(folder).glob("*.json"))}
    for page in map(docs.joinpath, PAGES):
        page.write_text(filled(page.read_text(encoding="utf-8"), results), encoding="utf-8")
    (docs / "images").mkdir(exist_ok=True)
    with mpl.rc_context({"font.size": 9, "figure.dpi": 110, "savefig.dpi": 110}):
        for name, draw in PICTURES.items():
            if name in results:
                draw(results[name]).savefig(docs / "images" / f"benchmark_{name}.png")
    plt.close("all")


def filled(page, results):
    """Return the page with its tables replaced by those of the results."""

    def replaced(match):
        name, table = match["name"], match["table"]
        if not results.get(name, {}).get(table):
            return match[0]
        content = results[name][table]
        lines = described(content) if table == "machine" else markdown(content)
        return f"<!-- {name}:{table} -->\n{lines}\n<!-- end -->"

    return re.sub(r"<!-- (?P<name>\w+):(?P<table>\w+) -->\n.*?<!-- end -->", replaced, page, flags=re.DOTALL)


def markdown(rows):
    heads = list(rows[0])
    lines = [heads, ["---"] * len(heads), *([cell(row[head], head) for head in heads] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value, head=""):
    """Return a number with the digits that mean something."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    if "NRMSE" in head or head == "best":
        return f"{value:.3f}"
    if "MAE" in head or "SMSE" in head:
        return f"{value:.4f}"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def described(machine):
    versions = ", ".join(f"{name} {version}" for name, version in machine["versions"].items() if name != "skdgp")
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['threads']} threads, {machine['blas']}; Python "
        f"{machine['python']}, {versions}; {machine['date']}, load before {machine['load']}."
    )


def colour(name):
    return PALETTE[next((colour for start, colour in COLOURS.items() if name.startswith(start)), "sky")]


def ticks_at(ax, values):
    """Label a logarithmic axis with these of the values that lie on it."""
    low, high = ax.get_xlim()
    ax.set_xticks([value for value in values if low <= value <= high])
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(NullLocator())


def heldout(results):
    """Draw error over seconds, a line for each method."""
    rows = results["error_over_time"]
    figure, ax = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
    for method in dict.fromkeys(row["method"] for row in rows):
        own = sorted((row["seconds"], row["NRMSE"]) for row in rows if row["method"] == method)
        style = {
            "color": colour(method),
            "label": method,
            "linestyle": next((style for word, style in DASHES.items() if word in method), "-"),
        }
        if method == "least squares":
            ax.axhline(own[0][1], linewidth=1, **style | {"linestyle": ":"})
        else:
            ax.plot(*zip(*own, strict=True), marker="o", markersize=4, **style)
    ax.set(xscale="log", xlabel="seconds of fitting", ylabel="NRMSE on the test flight")
    tidy(ax)
    ax.margins(x=0.03)
    ticks_at(ax, (0.01, 0.1, 1, 2, 5, 10, 20, 50, 100, 200))
    ax.legend(frameon=False, fontsize="small")
    return figure


def growth(results):
    """Draw seconds over N, a line for each contender, and ours over LAPACK for variants."""
    figure, (ax, beside) = plt.subplots(1, 2, figsize=(8.8, 3.8), layout="constrained", width_ratios=[1.5, 1])
    rows = results["samples"]
    for name in list(rows[0])[2:]:
        points = [(row["N"], row[name]) for row in rows if row[name] is not None]
        ax.loglog(*zip(*points, strict=True), marker="o", markersize=4, color=colour(name), label=name)
    ax.set(xlabel="N, values observed", ylabel="seconds, one likelihood and gradient")
    tidy(ax)
    ax.margins(x=0.03)
    ticks_at(ax, [row["N"] for row in rows])
    ax.legend(frameon=False, fontsize="small")
    rows = [row for table in ("latents", "regressors", "variants") for row in results[table]]
    beside.barh([row[""] for row in rows], [row["ratio"] for row in rows], color=PALETTE["blue"], height=0.6)
    beside.axvline(1, color=PALETTE["grey"], linewidth=1)
    beside.set(xlabel="times LAPACK potrf + potri")
    beside.invert_yaxis()
    tidy(beside)
    return figure


FLIGHTS = {  # of the comparison
    "viggen_latlon": "delta, two altitudes",
    "viggen_lateral": "delta, from lateral alone",
    "viggen_lateral_to_latlon": "delta, lateral to both",
    "c172p": "Cessna 172, calm air",
    "ampyx_ap2": "AP2, a real flight",
}
INPUTS = {"raw": "o", "filtered": "s", "reconstructed": "D", "own": "*"}


def comparison(results):
    """Draw the error of every method, a panel for each flight, a mark for each kind of inputs."""
    shown = [flight for flight in FLIGHTS if flight in results]
    methods = [_called(row) for row in max((results[flight] for flight in shown), key=len)]
    figure, axes = plt.subplots(
        1, len(shown), figsize=(2.0 + 2.2 * len(shown), 4.2), layout="constrained", sharey=True, squeeze=False
    )
    for ax, flight in zip(axes[0], shown, strict=True):
        for row in results[flight]:
            at, shade = methods.index(_called(row)), PALETTE["blue" if "skdgp" in row["method"] else "grey"]
            for kind, marker in INPUTS.items():
                error = row[f"NRMSE {kind}"]
                filled = shade if kind == "filtered" else "none"
                ax.plot(error, at, marker, color=shade, markerfacecolor=filled, markersize=5) if error else None
        ax.set_xlabel("NRMSE")
        ax.set_title(FLIGHTS[flight], fontsize="small")
        tidy(ax)
        ax.margins(x=0.06)
    axes[0, 0].set_yticks(range(len(methods)), methods)
    axes[0, 0].invert_yaxis()
    marks = [plt.Line2D([], [], linestyle="", marker=INPUTS[kind], color="grey", label=kind) for kind in INPUTS]
    for mark, kind in zip(marks, INPUTS, strict=True):
        mark.set_markerfacecolor("grey" if kind == "filtered" else "none")
    figure.legend(handles=marks, loc="outside lower right", ncols=4, frameon=False)
    return figure


def _called(row):
    return f"{row['method'].strip('*')}, {row['samples'] if row['samples'] < 1000 else 'all'}"


PICTURES = {"heldout": heldout, "growth": growth, "comparison": comparison}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what the benchmarks were given as --out")
    main(parser.parse_args().folder)
