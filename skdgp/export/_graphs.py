"""The model as a graph: a CasADi function for optimisation, an ONNX graph for inference runtimes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.typing import Array
from skdgp.export._model import PortableModel
from skdgp.export._reduce import check_terms
from skdgp.export._text import extra

OPSET, IR_VERSION = 17, 8


def casadi_function(model: PortableModel) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of
    ``model.regressor_names``. The Jacobian is that of the mean. The function can be differentiated
    further, also the deviation, and be saved with its method ``save``. A reduced model (``export
    --max-kb``) is faster. Raises ImportError if CasADi is not installed, ValueError if the model is
    too large, such as an exact one of many samples.
    """
    ca = extra("casadi")
    check_terms(model)
    x = ca.MX.sym("x", len(model.regressors))
    z = (x - ca.DM(model.shift)) / ca.DM(model.scale)
    p = ca.vertcat(1, z - ca.DM(model.trend_center))
    means, variances = [], []
    for j in range(len(model.readout_of)):
        value = ca.dot(ca.DM(model.trend_weights[j]), p)
        half = ca.mtimes(ca.DM(model.trend_roots[j].T), p)
        for block, weights, rows in model.terms(j):
            away = ca.repmat(z - ca.DM(block.shift), 1, block.size) - ca.DM(
                model.centres[block.rows].T
            )
            F = np.diag(block.root) if block.root.ndim == 1 else block.root.T
            g = block.gain * ca.exp(-0.5 * ca.sum1(ca.mtimes(ca.DM(F), away) ** 2)).T
            value += ca.dot(ca.DM(weights), g)
            half += ca.mtimes(ca.DM(rows.T), g)
        prior = model.prior_variance[j] + ca.sumsqr(ca.DM(model.trend_scale[j]) * p)
        means.append(value)
        variances.append(ca.fmax(prior - ca.sumsqr(half), np.finfo(float).eps * prior))
    parts, mixer = ca.vertcat(*means), ca.DM(model.mixer.T)
    mixed = ca.mtimes(mixer, parts)
    away = parts - ca.repmat(mixed, len(model.mixture), 1)
    variance = ca.mtimes(mixer, ca.vertcat(*variances) + away**2)
    mean = ca.DM(model.center) + ca.DM(model.output_scale) * mixed
    values = [mean, ca.DM(model.deviation_scale) * ca.sqrt(variance), ca.jacobian(mean, x)]
    return ca.Function("aero", [x], values, ["x"], ["mean", "std", "jacobian"])


def write_casadi(path: Path, model: PortableModel) -> Path:
    """Save the function of a model; ``casadi.Function.load`` reads it, in Python, C++ and MATLAB."""
    casadi_function(model).save(str(path))
    return path


def onnx_model(model: PortableModel) -> Any:
    """Return an ``onnx.ModelProto`` from regressors ``x`` (n, d) to ``mean`` (n, P) and ``std`` (n, P), in double.

    The regressors are in their units, in the order of ``model.regressor_names``. The metadata holds
    regressors and outputs as identifiers, "names" with the identifier of each name, the range of
    the training data and the content hash. A reduced model (``export --max-kb``) is faster. Raises
    ImportError if ONNX is not installed, ValueError if the model is too large, such as an exact one
    of many samples.
    """
    onnx = extra("onnx")
    check_terms(model)
    graph, helper = _Graph(onnx), onnx.helper
    z = graph("Div", graph("Sub", "x", model.shift), model.scale)
    trend = graph("Sub", z, model.trend_center)
    means, variances = [], []
    for j in range(len(model.readout_of)):
        weights, root = model.trend_weights[j], model.trend_roots[j]
        value = graph("Add", graph("MatMul", trend, weights[1:, None]), weights[:1, None])
        half = graph("Add", graph("MatMul", trend, root[1:]), root[:1])
        for block, w, rows in model.terms(j):
            square = graph.squares(
                graph("Sub", z, block.shift), block.root, model.centres[block.rows]
            )
            g = graph("Exp", graph("Mul", square, np.array(-0.5)))
            value = graph("Add", value, graph("MatMul", g, block.gain * w[:, None]))
            half = graph("Add", half, graph("MatMul", g, block.gain * rows))
        tau = model.trend_scale[j]
        prior = graph.sum(graph("Mul", graph("Mul", trend, trend), tau[1:] ** 2), 1)
        prior = graph("Add", prior, np.array(model.prior_variance[j] + tau[0] ** 2))
        explained = graph.sum(graph("Mul", half, half), 1)
        least = graph("Mul", prior, np.array(np.finfo(float).eps))
        means.append(value)
        variances.append(graph("Max", graph("Sub", prior, explained), least))
    parts, spread = (graph("Concat", *values, axis=1) for values in (means, variances))
    mean = graph("MatMul", parts, model.mixer)
    away = graph("Sub", parts, graph("Concat", *[mean] * len(model.mixture), axis=1))
    variance = graph("MatMul", graph("Add", spread, graph("Mul", away, away)), model.mixer)
    graph("Add", graph("Mul", mean, model.output_scale), model.center, out="mean")
    graph("Mul", graph("Sqrt", variance), model.deviation_scale, out="std")

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
    written, names = model.with_identifiers()
    lists = {"regressors": written.regressor_names, "outputs": written.outputs}
    lists |= {
        edge: tuple(map(repr, getattr(model.envelope, edge).tolist())) for edge in ("low", "high")
    }
    properties = {name: ",".join(values) for name, values in lists.items()}
    properties |= {"names": json.dumps(names), "content_hash": model.content_hash}
    helper.set_model_props(proto, properties)
    onnx.checker.check_model(proto)
    return proto


def write_onnx(path: Path, model: PortableModel) -> Path:
    """Write the graph of a model."""
    path.write_bytes(onnx_model(model).SerializeToString())
    return path


class _Graph:
    """Nodes and constants of a graph; called with an operator and its inputs, it returns the name of the result."""

    def __init__(self, onnx: Any) -> None:
        self.onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def __call__(
        self, kind: str, *inputs: str | Array, out: str | None = None, **attributes: Any
    ) -> str:
        out = f"v{len(self.nodes)}" if out is None else out
        names = []
        for each in inputs:
            names.append(each if isinstance(each, str) else f"c{len(self.constants)}")
            if not isinstance(each, str):
                self.constants.append(
                    self.onnx.numpy_helper.from_array(np.ascontiguousarray(each), names[-1])
                )
        self.nodes.append(self.onnx.helper.make_node(kind, names, [out], **attributes))
        return out

    def sum(self, values: str, axis: int) -> str:
        """Return the sum over an axis, which stays with length one."""
        return self("ReduceSum", values, np.array([axis]), keepdims=1)

    def squares(self, z: str, root: Array, centres: Array) -> str:
        """Return |F^T (z - Z_k)|^2, (n, k)."""
        wide, scaled = (self("Mul", z, root), centres * root) if root.ndim == 1 else (
            self("MatMul", z, root), centres @ root,
        )  # fmt: skip
        away = self("Sub", self("Unsqueeze", wide, np.array([1])), scaled[None])
        summed = self.sum(self("Mul", away, away), 2)
        return self("Squeeze", summed, np.array([2]))
