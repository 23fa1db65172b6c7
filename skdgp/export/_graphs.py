"""The model as a graph: a CasADi function for optimisation, an ONNX graph for inference runtimes."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.export._model import ROUNDING, Part, PortableModel, Term

OPSET, IR_VERSION = 17, 8


def used_basis(part: Part) -> tuple[list[list[Term]], Vector, Matrix]:
    """Return the entries of the basis of a part that are not zero: terms, weights and rows of the root.

    Terms are in the order of the basis; the terms of each list add up.
    """
    order = sorted(part.terms, key=attrgetter("first"))
    terms = [list(group) for _, group in groupby(order, key=attrgetter("first"))]
    weights, root = part.readout.weights, part.readout.root
    rows = np.concatenate([np.arange(0), *(np.r_[group[0].entries] for group in terms)])
    return (terms, weights, root) if len(rows) == len(root) else (terms, weights[rows], root[rows])


def mixer(model: PortableModel) -> Array:
    """Return the matrix (K P, P) of the weighted sums that make outputs from values of parts (n, K P)."""
    return np.vstack([np.diag(weights) for weights in model.mixture])


def casadi_function(model: PortableModel) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of
    ``model.regressor_names``. The Jacobian is the mean's. The function can be differentiated
    further, also the deviation, and be saved with its method ``save``. A reduced model
    (``export_model`` with ``max_kb``) is faster. Raises ImportError if CasADi is not installed.
    """
    ca = extra("casadi", "export")
    x = ca.MX.sym("x", len(model.regressors))
    z = (x - ca.DM(model.shift)) / ca.DM(model.scale)
    p = ca.vertcat(1, z - ca.DM(model.trend_center))

    def functions(term):
        away = ca.repmat(ca.DM(term.root.T) @ z, 1, len(term.centres)) - ca.DM(term.centres.T)
        return term.gain * ca.exp(-0.5 * ca.sum1(away**2)).T

    means, variances = [], []
    for part in model.parts:
        terms, weights, root = used_basis(part)
        g = ca.vertcat(*(sum(map(functions, group)) for group in terms))
        value = ca.dot(ca.DM(part.trend_weights), p)
        half = ca.DM(part.trend_root.T) @ p
        if terms:
            value += ca.dot(ca.DM(weights), g)
            explained = ca.DM(root.T) @ g
            half += ca.vertcat(ca.DM.zeros(half.shape[0] - explained.shape[0]), explained)
        prior = part.prior_variance + ca.sumsqr(ca.DM(part.trend_scale) * p)
        means.append(value)
        variances.append(ca.fmax(prior - ca.sumsqr(half), ROUNDING * prior))
    of_parts = ca.vertcat(*means)
    mixed = ca.DM(mixer(model).T) @ of_parts
    away = of_parts - ca.repmat(mixed, len(model.mixture), 1)
    variance = ca.DM(mixer(model).T) @ (ca.vertcat(*variances) + away**2)
    mean = ca.DM(model.center) + ca.DM(model.output_scale) * mixed
    values = [mean, ca.DM(model.output_scale) * ca.sqrt(variance), ca.jacobian(mean, x)]
    return ca.Function("aero", [x], values, ["x"], ["mean", "std", "jacobian"])


def write_casadi(folder: Path, model: PortableModel) -> list[Path]:
    """Save the function of a model; ``casadi.Function.load`` reads it, in Python, C++ and MATLAB."""
    path = folder / "aero.casadi"
    casadi_function(model).save(str(path))
    return [path]


def onnx_model(model: PortableModel) -> Any:
    """Return an ``onnx.ModelProto`` from regressors ``x`` (n, d) to ``mean`` (n, P) and ``std`` (n, P), in double.

    The regressors are in their units, in the order of ``model.regressor_names``. The metadata holds
    the names of regressors and outputs, the range of the training data and the content hash. A
    reduced model (``export_model`` with ``max_kb``) is faster. Raises ImportError if ONNX is not
    installed.
    """
    onnx = extra("onnx", "export")
    graph = _Graph(onnx)
    z = graph("Div", graph("Sub", "x", model.shift), model.scale)
    p = graph("Sub", z, model.trend_center)

    def functions(term):
        away = graph(
            "Sub", graph("Unsqueeze", graph("MatMul", z, term.root), [1]), term.centres[None]
        )
        square = graph("Squeeze", graph.squares(away, 2), [2])
        return graph("Mul", graph("Exp", graph("Mul", square, np.array(-0.5))), np.array(term.gain))

    def plane(weights):
        """Return p (1, ...) @ weights."""
        return graph("Add", graph("MatMul", p, weights[1:]), weights[:1])

    means, variances = [], []
    for part in model.parts:
        value = plane(part.trend_weights[:, None])
        half = plane(part.trend_root)
        terms, weights, root = used_basis(part)
        if terms:
            g = graph("Concat", *(graph("Sum", *map(functions, group)) for group in terms), axis=1)
            offset = part.trend_root.shape[1] - len(part.readout.weights)
            value = graph("Add", value, graph("MatMul", g, weights[:, None]))
            half = graph("Add", half, graph("Pad", graph("MatMul", g, root), [0, offset, 0, 0]))
        tau = part.trend_scale
        prior = graph.squares(graph("Mul", p, tau[1:]), 1)
        prior = graph("Add", prior, np.array(part.prior_variance + tau[0] ** 2))
        least = graph("Mul", prior, np.array(ROUNDING))
        means.append(value)
        variances.append(graph("Max", graph("Sub", prior, graph.squares(half, 1)), least))
    of_parts = graph("Concat", *means, axis=1)
    mixed = graph("MatMul", of_parts, mixer(model))
    away = graph("Sub", of_parts, graph("Concat", *[mixed] * len(model.mixture), axis=1))
    spread = graph("Add", graph("Concat", *variances, axis=1), graph("Mul", away, away))
    deviation = graph("Sqrt", graph("MatMul", spread, mixer(model)))
    graph("Add", graph("Mul", mixed, model.output_scale), model.center, out="mean")
    graph("Mul", deviation, model.output_scale, out="std")
    return _checked(onnx, graph, model)


def _checked(onnx: Any, graph: _Graph, model: PortableModel) -> Any:
    """Return the model of a graph, with its metadata."""
    helper = onnx.helper
    sizes = {"x": len(model.regressors), "mean": len(model.outputs), "std": len(model.outputs)}
    x, *results = (
        helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, ["n", n])
        for name, n in sizes.items()
    )
    made = helper.make_graph(graph.nodes, "aero", [x], results, graph.constants)
    opset = helper.make_opsetid("", OPSET)
    proto = helper.make_model(
        made, opset_imports=[opset], ir_version=IR_VERSION, producer_name="skdgp"
    )
    properties = {
        "regressors": ",".join(model.regressor_names),
        "outputs": ",".join(model.outputs),
        "low": ",".join(map(repr, model.limits[0].tolist())),
        "high": ",".join(map(repr, model.limits[1].tolist())),
        "servo_lag": repr(float(model.servo_lag[0])),
        "content_hash": model.content_hash,
    }
    helper.set_model_props(proto, properties)
    onnx.checker.check_model(proto)
    return proto


def write_onnx(folder: Path, model: PortableModel) -> list[Path]:
    """Write the graph of a model."""
    path = folder / "aero.onnx"
    path.write_bytes(onnx_model(model).SerializeToString())
    return [path]


class _Graph:
    """Nodes and constants of a graph; called with an operator and its inputs, it returns the name of the result."""

    def __init__(self, onnx: Any) -> None:
        self.onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.names: dict[int, tuple[str, Any]] = {}  # with the constant itself, so that ids last

    def __call__(
        self, kind: str, *inputs: str | Array | list[int], out: str | None = None, **attributes: Any
    ) -> str:
        out = out or f"v{len(self.nodes)}"
        names = [value if isinstance(value, str) else self.constant(value) for value in inputs]
        self.nodes.append(self.onnx.helper.make_node(kind, names, [out], **attributes))
        return out

    def constant(self, values: Array | list[int]) -> str:
        """Return the name of a constant; one array is one constant."""
        if id(values) not in self.names:
            self.names[id(values)] = f"c{len(self.constants)}", values
            array = np.array(values, order="C")
            tensor = self.onnx.numpy_helper.from_array(array, self.names[id(values)][0])
            self.constants.append(tensor)
        return self.names[id(values)][0]

    def squares(self, values: str, axis: int) -> str:
        """Return the sum of squares over an axis, which stays with length one."""
        return self("ReduceSum", self("Mul", values, values), [axis], keepdims=1)
