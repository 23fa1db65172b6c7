"""Bring the page of results up to date: marked tables and the picture from the scripts' results.

    python tests/benchmarks/page.py FOLDER

FOLDER is what the scripts were given as --out. A table stands on the page between ``<!-- NAME:TABLE
-->`` and ``<!-- end -->``, and is that TABLE of NAME.json; ``NAME:machine`` says where it was
measured. What has no results stays as it is.
"""

import argparse
import json
import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from skdgp._display.style import PALETTE, tidy

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("results.md",)


def main(folder, docs=DOCS):
    results = {
        path.stem: json.loads(path.read_text()) for path in sorted(Path(folder).glob("*.json"))
    }
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

    return re.sub(
        r"<!-- (?P<name>\w+):(?P<table>\w+) -->\n.*?<!-- end -->", replaced, page, flags=re.DOTALL
    )


def markdown(rows):
    heads = list(rows[0])
    lines = [
        heads,
        ["---"] * len(heads),
        *([cell(row[head], head) for head in heads] for row in rows),
    ]
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
    versions = ", ".join(
        f"{name} {version}" for name, version in machine["versions"].items() if name != "skdgp"
    )
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['threads']} threads, "
        f"{machine['blas']}; Python "
        f"{machine['python']}, {versions}; {machine['date']}, load before {machine['load']}."
    )


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
        1,
        len(shown),
        figsize=(2.0 + 2.2 * len(shown), 4.2),
        layout="constrained",
        sharey=True,
        squeeze=False,
    )
    for ax, flight in zip(axes[0], shown, strict=True):
        for row in results[flight]:
            at, shade = (
                methods.index(_called(row)),
                PALETTE["blue" if "skdgp" in row["method"] else "grey"],
            )
            for kind, marker in INPUTS.items():
                error = row[f"NRMSE {kind}"]
                filled = shade if kind == "filtered" else "none"
                ax.plot(
                    error, at, marker, color=shade, markerfacecolor=filled, markersize=5
                ) if error else None
        ax.set_xlabel("NRMSE")
        ax.set_title(FLIGHTS[flight], fontsize="small")
        tidy(ax)
        ax.margins(x=0.06)
    axes[0, 0].set_yticks(range(len(methods)), methods)
    axes[0, 0].invert_yaxis()
    marks = [
        plt.Line2D([], [], linestyle="", marker=INPUTS[kind], color="grey", label=kind)
        for kind in INPUTS
    ]
    for mark, kind in zip(marks, INPUTS, strict=True):
        mark.set_markerfacecolor("grey" if kind == "filtered" else "none")
    figure.legend(handles=marks, loc="outside lower right", ncols=4, frameon=False)
    return figure


def _called(row):
    return f"{row['method'].strip('*')}, {row['samples'] if row['samples'] < 1000 else 'all'}"


PICTURES = {"comparison": comparison}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what the benchmarks were given as --out")
    main(parser.parse_args().folder)
