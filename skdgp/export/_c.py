"""The model as C99: one header, one source, no allocation, and a self-test with vectors of the model."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Matrix
from skdgp.export._model import PortableModel

PRECISIONS = {"double": (8, "double", "", 1e-9), "float": (4, "float", "f", 1e-4)}
"""Bytes, type, suffix of literals and functions, and tolerance of the self-test."""
MAX_BYTES = 2**26  # of tables; more is no source that a compiler takes
N_VECTORS = 40
PER_LINE = 8

HEADER = """\
/* Aerodynamic coefficients of {aircraft}, with their standard deviations.
 *
 * A posterior mean and deviation of Gaussian processes, written by skdgp. Tables: {size} bytes.
 * Content {hash}
 *
 * SI units and radians, body axes x forward, y right, z down. Force = dynamic pressure * AERO_WING_AREA * coefficient;
 * moment = the same times AERO_SPAN (Cl, Cn) or AERO_CHORD (Cm). Every function is reentrant, allocates nothing and uses
 * at most {stack} bytes of stack for its arrays.
 */
#ifndef AERO_H
#define AERO_H

#ifdef __cplusplus
extern "C" {{
#endif

typedef {real} aero_real;

#define AERO_SOURCES {n_sources}
#define AERO_INPUTS {d}
#define AERO_OUTPUTS {P}

/* Sources, columns of a flight: {sources}
 * Inputs, regressors:           {inputs}
 * Outputs, coefficients:        {outputs} */
extern const char *const aero_source_names[AERO_SOURCES];
extern const char *const aero_input_names[AERO_INPUTS];
extern const char *const aero_output_names[AERO_OUTPUTS];

/* Smallest and largest value of each input that the model was learned from. */
extern const aero_real aero_low[AERO_INPUTS], aero_high[AERO_INPUTS];

{constants}

/* Inputs of the sources: non-dimensional rates, mixed controls. */
void aero_inputs(const aero_real source[AERO_SOURCES], aero_real x[AERO_INPUTS]);

/* Mean of every coefficient and, unless std is NULL, its standard deviation at exact inputs. */
void aero_predict(const aero_real x[AERO_INPUTS], aero_real mean[AERO_OUTPUTS], aero_real std[AERO_OUTPUTS]);

/* Slopes of the means, d mean[i] / d x[k]. */
void aero_gradient(const aero_real x[AERO_INPUTS], aero_real slope[AERO_OUTPUTS][AERO_INPUTS]);

/* Zero within the flown envelope; else bit k is set for each input k outside of its range. */
unsigned long aero_beyond(const aero_real x[AERO_INPUTS]);

#ifdef __cplusplus
}}
#endif

#endif
"""

SOURCE = """\
/* See aero.h. */
#include "aero.h"

#include <math.h>
#include <stddef.h>

#define FUNCTIONS {functions} /* of the largest basis, at least 1 */

/* Gaussian functions gain * exp(-|F (z - shift - centre)|^2 / 2) of some inputs, one for each centre. */
typedef struct {{
    int column, size, n_used;
    const unsigned char *used;
    const aero_real *centres, *shift, *root;
    aero_real gain;
}} block;

{tables}

static void scaled(const aero_real x[], aero_real z[])
{{
    int k;
    for (k = 0; k < AERO_INPUTS; k++)
        z[k] = (x[k] - shift[k]) / scale[k];
}}

/* The exponential of one function, and away = S (z - shift - centre), if it is asked for. */
static aero_real exponential(const block *b, int c, const aero_real u[], aero_real away[])
{{
    const aero_real *centre = b->centres + (size_t)c * (size_t)b->n_used;
    aero_real square = 0;
    int k{more};
{exponent}
    return b->gain * {exp}(-square / 2);
}}

static void relative(const block *b, const aero_real z[], aero_real u[])
{{
    int k;
    for (k = 0; k < b->n_used; k++)
        u[k] = z[b->used[k]] - b->shift[k];
}}

void aero_inputs(const aero_real source[AERO_SOURCES], aero_real x[AERO_INPUTS])
{{
{formulas}
}}

void aero_predict(const aero_real x[AERO_INPUTS], aero_real mean[AERO_OUTPUTS], aero_real std[AERO_OUTPUTS])
{{
    aero_real z[AERO_INPUTS], u[AERO_INPUTS], p[AERO_INPUTS + 1], g[FUNCTIONS];
    int i, b, c, k, r;
    scaled(x, z);
    p[0] = 1;
    for (k = 0; k < AERO_INPUTS; k++)
        p[k + 1] = z[k] - trend_center[k];
    for (i = 0; i < AERO_OUTPUTS; i++) {{
        const int n = n_functions[i], rank = n_columns[i];
        const aero_real *T = trend_root[i], *U = root[i];
        aero_real value = 0, prior = prior_variance[i], explained = 0;
        for (c = 0; c < n; c++)
            g[c] = 0;
        for (b = first_block[i]; b < first_block[i + 1]; b++) {{
            relative(&blocks[b], z, u);
            for (c = 0; c < blocks[b].size; c++)
                g[blocks[b].column + c] += exponential(&blocks[b], c, u, NULL);
        }}
        for (k = 0; k <= AERO_INPUTS; k++)
            value += p[k] * trend_weights[i][k];
        for (c = 0; c < n; c++)
            value += g[c] * weights[i][c];
        mean[i] = center[i] + output_scale[i] * value;
        if (std == NULL)
            continue;
        for (k = 0; k <= AERO_INPUTS; k++) {{
            const aero_real t = p[k] * trend_scale[i][k];
            prior += t * t;
        }}
        for (r = 0; r < rank; r++) {{
            const int length = r + 1 - (rank - n);
            aero_real half = 0;
            for (k = 0; k <= AERO_INPUTS; k++)
                half += p[k] * *T++;
            for (c = 0; c < length; c++)
                half += g[c] * *U++;
            explained += half * half;
        }}
        std[i] = prior - explained > {eps} * prior ? prior - explained : {eps} * prior;
        std[i] = deviation_scale[i] * {sqrt}(std[i]);
    }}
}}

void aero_gradient(const aero_real x[AERO_INPUTS], aero_real slope[AERO_OUTPUTS][AERO_INPUTS])
{{
    aero_real z[AERO_INPUTS], u[AERO_INPUTS], away[AERO_INPUTS];
    int i, b, c, k;
    scaled(x, z);
    for (i = 0; i < AERO_OUTPUTS; i++) {{
        for (k = 0; k < AERO_INPUTS; k++)
            slope[i][k] = trend_weights[i][k + 1];
        for (b = first_block[i]; b < first_block[i + 1]; b++) {{
            const block *of = &blocks[b];
            relative(of, z, u);
            for (c = 0; c < of->size; c++) {{
                const aero_real e = weights[i][of->column + c] * exponential(of, c, u, away);
                for (k = 0; k < of->n_used; k++)
                    slope[i][of->used[k]] -= e * away[k];
            }}
        }}
        for (k = 0; k < AERO_INPUTS; k++)
            slope[i][k] *= output_scale[i] / scale[k];
    }}
}}

unsigned long aero_beyond(const aero_real x[AERO_INPUTS])
{{
    unsigned long found = 0;
    int k;
    for (k = 0; k < AERO_INPUTS; k++)
        if (!(x[k] >= aero_low[k] && x[k] <= aero_high[k]))
            found |= 1UL << k;
    return found;
}}
"""

DIAGONAL = """\
    for (k = 0; k < b->n_used; k++) {
        const aero_real a = (u[k] - centre[k]) * b->root[k];
        if (away != NULL)
            away[k] = a * b->root[k];
        square += a * a;
    }"""

FULL = """\
    if (away != NULL)
        for (k = 0; k < b->n_used; k++)
            away[k] = 0;
    for (l = 0; l < b->n_used; l++) {
        aero_real a = 0;
        for (k = 0; k < b->n_used; k++)
            a += (u[k] - centre[k]) * b->root[k * b->n_used + l];
        if (away != NULL)
            for (k = 0; k < b->n_used; k++)
                away[k] += a * b->root[k * b->n_used + l];
        square += a * a;
    }"""

TEST = """\
/* Compares aero.c with the model that wrote it, and measures the time of a row. */
#include "aero.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <time.h>

#define VECTORS {n}
#define TOLERANCE {tolerance}

{tables}

static double larger(double worst, double error, double size)
{{
    error = fabs(error) / size;
    return error > worst || error != error ? error : worst; /* NaN is an error */
}}

static double seconds(int with_std, int rows)
{{
    aero_real mean[AERO_OUTPUTS], std[AERO_OUTPUTS];
    const clock_t start = clock();
    int n;
    for (n = 0; n < rows; n++)
        aero_predict(at[n % VECTORS], mean, with_std ? std : NULL);
    return (double)(clock() - start) / CLOCKS_PER_SEC / rows;
}}

int main(void)
{{
    double mean_error = 0, std_error = 0, slope_error = 0;
    int n, i, k, wrong = 0, rows;
    for (n = 0; n < VECTORS; n++) {{
        aero_real mean[AERO_OUTPUTS], alone[AERO_OUTPUTS], std[AERO_OUTPUTS], slope[AERO_OUTPUTS][AERO_INPUTS];
        aero_predict(at[n], mean, std);
        aero_predict(at[n], alone, NULL);
        aero_gradient(at[n], slope);
        wrong += aero_beyond(at[n]) != beyond[n];
        for (i = 0; i < AERO_OUTPUTS; i++) {{
            wrong += alone[i] != mean[i];
            mean_error = larger(mean_error, mean[i] - says_mean[n][i], mean_size[i]);
            std_error = larger(std_error, std[i] - says_std[n][i], std_size[i]);
            for (k = 0; k < AERO_INPUTS; k++)
                slope_error = larger(slope_error, slope[i][k] - says_slope[n][i][k], slope_size[i][k]);
        }}
    }}
    for (rows = 64; seconds(1, rows) * rows < 0.1; rows *= 2)
        ;
    printf("largest errors over scale: mean %.2g, deviation %.2g, slope %.2g\\n", mean_error, std_error, slope_error);
    printf("time of a row: mean %.3g us, with deviation %.3g us\\n", 1e6 * seconds(0, rows), 1e6 * seconds(1, rows));
    if (wrong || !(mean_error < TOLERANCE && std_error < TOLERANCE && slope_error < TOLERANCE)) {{
        printf("FAILED: %d other values differ, and errors are to be below %g\\n", wrong, TOLERANCE);
        return 1;
    }}
    printf("passed: {n} points\\n");
    return 0;
}}
"""

MAKEFILE = """\
CC = gcc
CFLAGS = -O2 -std=c99 -Wall -Wextra -Werror -pedantic

aero.o: aero.c aero.h
\t$(CC) $(CFLAGS) -c aero.c

test_aero: test_aero.c aero.o
\t$(CC) $(CFLAGS) -o test_aero test_aero.c aero.o -lm

test: test_aero
\t./test_aero

clean:
\trm -f aero.o test_aero

.PHONY: test clean
"""


def c_files(model: PortableModel, precision: str = "double") -> dict[str, str]:
    """Return the texts of aero.h, aero.c, test_aero.c and the Makefile by name.

    Raises
    ------
    ValueError
        If the precision is another, the model has more than 32 regressors, or its tables are too large for C.
    """
    if precision not in PRECISIONS:
        raise ValueError(f"Got precision={precision!r}, but expected one of {list(PRECISIONS)}.")
    size = c_bytes(model, precision)
    if size > MAX_BYTES:
        raise ValueError(
            f"Got a model whose tables take {size / 1e6:.0f} MB in C, but expected at most {MAX_BYTES / 1e6:.0f} MB: "
            "compact it first with max_kb=256, or another size."
        )
    if len(model.regressors) > 32:
        raise ValueError(f"Got {len(model.regressors)} regressors, but expected at most 32: name fewer.")
    return {
        "aero.h": _header(model, precision, size),
        "aero.c": _source(model, precision),
        "test_aero.c": _test(model, precision),
        "Makefile": MAKEFILE,
    }


def c_bytes(model: PortableModel, precision: str = "double") -> int:
    """Return the bytes of the tables in flash."""
    tables = _tables(model)
    numbers = sum(np.size(values) for values in tables.numbers.values())
    numbers += sum(len(root) * (root.shape[1]) for root in model.trend_roots)
    numbers += sum(readout.size + len(readout.packed_root) for readout in model.readouts)
    return numbers * PRECISIONS[precision][0] + len(tables.used) + 48 * len(model.blocks)


class _tables:
    """The tables of the blocks: centres of the used regressors, each once, and the rows of the array of blocks."""

    def __init__(self, model: PortableModel) -> None:
        self.full = any(block.root.ndim == 2 for block in model.blocks)
        centres: list[Array] = []
        shifts: list[Array] = []
        roots: list[Array] = []
        self.used: list[int] = []
        self.rows: list[tuple] = []
        places: dict[tuple, int] = {}
        n_centres = n_shifts = n_roots = 0
        for block in sorted(model.blocks, key=lambda block: block.output):
            used = tuple(range(len(model.regressors))) if block.root.ndim == 2 else block.regressors
            index = list(used)
            key = block.first_centre, block.size, used
            if key not in places:
                places[key] = n_centres
                centres.append(model.centres[block.rows][:, index].ravel())
                n_centres += len(centres[-1])
            root = block.root if block.root.ndim == 2 else block.root[index]
            root = np.diag(root) if self.full and root.ndim == 1 else root
            self.rows.append(
                (block.first_column, block.size, len(used), len(self.used), places[key], n_shifts, n_roots, block.gain)
            )
            self.used += index
            shifts.append(block.shift[index])
            roots.append(root.ravel())
            n_shifts += len(index)
            n_roots += root.size
        self.numbers = {
            name: np.concatenate(parts) if parts else np.zeros(1)
            for name, parts in (("centres", centres), ("shifts", shifts), ("roots", roots))
        }


def _header(model, precision, size) -> str:
    aircraft, width = model.aircraft, PRECISIONS[precision][0]
    functions = max(readout.size for readout in model.readouts)
    names = [("MASS", aircraft.mass), ("WING_AREA", aircraft.wing_area), ("SPAN", aircraft.span)]
    names += [("CHORD", aircraft.chord)]
    names += [(f"I{a}{b}", aircraft.inertia[i, j]) for a, b, i, j in _AXES]
    lines = [f"#define AERO_{name} {float(value)!r}" for name, value in names]
    return HEADER.format(
        aircraft=_comment(aircraft.name),
        size=size,
        hash=model.content_hash,
        stack=width * (functions + 3 * len(model.regressors) + 1),
        real=PRECISIONS[precision][1],
        n_sources=len(_sources(model)),
        d=len(model.regressors),
        P=len(model.outputs),
        sources=_comment(", ".join(_sources(model))),
        inputs=_comment(", ".join(model.regressor_names)),
        outputs=_comment(", ".join(model.outputs)),
        constants="/* kg, m^2, m, m; the inertia tensor in kg m^2, off its diagonal minus the products of inertia. */\n"
        + "\n".join(lines),
    )


_AXES = [("X", "X", 0, 0), ("Y", "Y", 1, 1), ("Z", "Z", 2, 2), ("X", "Y", 0, 1), ("X", "Z", 0, 2), ("Y", "Z", 1, 2)]


def _sources(model) -> list[str]:
    """Return every column of a flight that the regressors are computed from, each once."""
    return list(dict.fromkeys(name for regressor in model.regressors for name in regressor.columns))


def _source(model, precision) -> str:
    _, _, suffix, _ = PRECISIONS[precision]
    P, tables = len(model.outputs), _tables(model)
    order = sorted(block.output for block in model.blocks)
    first = np.searchsorted(order, np.arange(P + 1)).tolist()
    readouts = [model.readouts[k] for k in model.readout_of]
    texts = [
        _names("aero_source_names", _sources(model)),
        _names("aero_input_names", model.regressor_names),
        _names("aero_output_names", model.outputs),
        _table("aero_low", np.maximum(model.envelope.low, -1e30), suffix, static=False),
        _table("aero_high", np.minimum(model.envelope.high, 1e30), suffix, static=False),
        *(_table(name, getattr(model, name), suffix) for name in _VECTORS),
        *(_table(name, values, suffix) for name, values in tables.numbers.items()),
        f"static const unsigned char used[{max(1, len(tables.used))}] = {{{', '.join(map(str, tables.used or [0]))}}};",
        _blocks(tables.rows, suffix),
        _integers("first_block", first),
        _integers("n_functions", [readout.size for readout in readouts]),
        _integers("n_columns", [root.shape[1] for root in model.trend_roots]),
        *(_table(f"weights_{k}", r.weights, suffix) for k, r in enumerate(model.readouts)),
        *(_table(f"root_{k}", r.packed_root, suffix) for k, r in enumerate(model.readouts)),
        *(_table(f"trend_root_{i}", root.T.ravel(), suffix) for i, root in enumerate(model.trend_roots)),
        _pointers("weights", [f"weights_{k}" for k in model.readout_of]),
        _pointers("root", [f"root_{k}" for k in model.readout_of]),
        _pointers("trend_root", [f"trend_root_{i}" for i in range(P)]),
    ]
    return SOURCE.format(
        functions=max(1, *(readout.size for readout in model.readouts)),
        tables="\n".join(texts),
        more=", l" if tables.full else "",
        exponent=FULL if tables.full else DIAGONAL,
        exp=f"exp{suffix}",
        sqrt=f"sqrt{suffix}",
        eps=f"{np.finfo(float if precision == 'double' else np.float32).eps:.9g}{suffix}",
        formulas="\n".join(_formulas(model, suffix)),
    )


_VECTORS = (
    *("shift", "scale", "center", "output_scale", "deviation_scale", "prior_variance", "trend_center", "trend_scale"),
    "trend_weights",
)


def _test(model, precision) -> str:
    _, _, suffix, tolerance = PRECISIONS[precision]
    X = _points(model)
    if precision == "float":
        X = X.astype(np.float32).astype(float)
    mean, std = model.predict(X, return_std=True)
    slope = model.predict_gradient(X)
    size = np.abs(slope * model.scale).max(axis=(0, 2))[:, None] / model.scale
    low, high = (edge.astype(np.float32 if precision == "float" else float) for edge in _edges(model))
    bits = (((low > X) | (high < X)) * 2 ** np.arange(X.shape[1])).sum(axis=1).astype(int)
    texts = [
        _table("at", X, suffix),
        f"static const unsigned long beyond[VECTORS] = {{{', '.join(f'{b}UL' for b in bits)}}};",
        *(_table(*table, "", real="double") for table in (("says_mean", mean), ("says_std", std), ("says_slope", slope))),
        _table("mean_size", np.abs(mean).max(axis=0), "", real="double"),
        _table("std_size", std.max(axis=0), "", real="double"),
        _table("slope_size", np.where(size > 0, size, 1.0), "", real="double"),
    ]
    return TEST.format(n=len(X), tolerance=tolerance, tables="\n".join(texts))


def _edges(model):
    return np.maximum(model.envelope.low, -1e30), np.minimum(model.envelope.high, 1e30)


def _points(model) -> Matrix:
    """Return points of the envelope and around it, the same at every call."""
    rng = np.random.default_rng(0)
    samples = model.envelope.samples
    if not len(samples):
        low, high = (np.where(np.isfinite(e), e, model.shift) for e in (model.envelope.low, model.envelope.high))
        samples = rng.uniform(low, high, (N_VECTORS, len(low)))
    X = samples[np.linspace(0, len(samples) - 1, N_VECTORS).astype(int)].copy()
    X[1::2] += 0.5 * model.scale * rng.standard_normal(X[1::2].shape)
    return X


# -- C -------------------------------------------------------------------------------------------------------------


def _table(name, values, suffix, *, static=True, real="aero_real") -> str:
    """Return a constant array of its shape; an empty one has one zero, since C has none."""
    values = np.asarray(values, dtype=float)
    values = values if values.size else np.zeros(1)
    digits = 9 if suffix else 17
    shape = "".join(f"[{n}]" for n in values.shape)
    return f"{'static ' * static}const {real} {name}{shape} = {_braces(values, suffix, digits)};"


def _braces(values: Array, suffix: str, digits: int) -> str:
    if values.ndim > 1:
        return "{" + ",\n".join(_braces(row, suffix, digits) for row in values) + "}"
    words = [_literal(value, suffix, digits) for value in values.tolist()]
    lines = [", ".join(words[a : a + PER_LINE]) for a in range(0, len(words), PER_LINE)]
    return "{" + ",\n".join(lines) + "}"


def _literal(value: float, suffix: str, digits: int) -> str:
    if suffix:  # subnormal numbers of float are zero on many processors
        value = float(np.float32(value)) if abs(value) > np.finfo(np.float32).tiny else 0.0
    text = f"{value:.{digits}g}"
    return f"{text if '.' in text or 'e' in text else text + '.0'}{suffix}"


def _integers(name: str, values: Iterable[int]) -> str:
    values = list(values)
    return f"static const int {name}[{len(values)}] = {{{', '.join(map(str, values))}}};"


def _pointers(name: str, tables: list[str]) -> str:
    return f"static const aero_real *const {name}[{len(tables)}] = {{{', '.join(tables)}}};"


def _names(name: str, values: Iterable[str]) -> str:
    values = list(values)
    return f"const char *const {name}[{len(values)}] = {{{', '.join(json.dumps(value) for value in values)}}};"


def _blocks(rows: list[tuple], suffix: str) -> str:
    lines = [
        f"{{{column}, {size}, {n}, used + {used}, centres + {centre}, shifts + {shift}, roots + {root}, "
        f"{_literal(gain, suffix, 9 if suffix else 17)}}}"
        for column, size, n, used, centre, shift, root, gain in rows
    ] or ["{0, 0, 0, used, centres, shifts, roots, 0}"]
    return f"static const block blocks[{len(lines)}] = {{" + ",\n".join(lines) + "};"


def _formulas(model, suffix) -> Iterable[str]:
    """Yield the statement of each input."""
    place = {name: k for k, name in enumerate(_sources(model))}
    for k, regressor in enumerate(model.regressors):
        terms = [
            f"source[{place[name]}]" if factor == 1 else f"{_literal(factor, suffix, 17)} * source[{place[name]}]"
            for name, factor in zip(regressor.sources, regressor.factors, strict=True)
        ]
        text = " + ".join(terms)
        if regressor.power:
            rate = f" * ({_literal(regressor.length, suffix, 17)} / (2 * source[{place['airspeed']}]))"
            text = (f"({text})" if len(terms) > 1 else text) + rate * regressor.power
        yield f"    x[{k}] = {text}; /* {_comment(regressor.name)} */"


def _comment(text: Any) -> str:
    """Return a text that can stand in a comment of C."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in str(text)).replace("*/", "* /").replace("/*", "/ *")
