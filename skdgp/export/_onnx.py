"""The model as an ONNX graph: mean and deviation, for inference runtimes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.typing import Array
from skdgp.export._model import PortableModel
from skdgp.export._reduce import check_terms

NEEDED = 'This format needs ONNX, which is not installed: pip install "skdgp[export]".'
OPSET, IR_VERSION = 17, 8


def onnx_model(model: PortableModel) -> Any:
    """Return an ``onnx.ModelProto`` from regressors ``x`` (n, d) to ``mean`` (n, P) and ``std`` (n, P), in double.

    The regressors are in their units, in the order of ``model.regressor_names``. The metadata holds regressors and
    outputs as identifiers, "names" with the identifier of each name, the range of the training data and the content
    hash. A reduced model (``export --max-kb``) is faster. Raises ImportError if ONNX is not installed, ValueError if
    the model is too large, such as an exact one of many samples.
    """
    try:
        from onnx import TensorProto, checker, helper
    except ImportError as error:
        raise ImportError(NEEDED) from error
    check_terms(model)
    graph = _Graph()
    z = graph("Div", graph("Sub", "x", model.shift), model.scale)
    trend = graph("Sub", z, model.trend_center)
    means, variances = [], []
    for j in range(len(model.readout_of)):
        weights, root = model.trend_weights[j], model.trend_roots[j]
        value = graph("Add", graph("MatMul", trend, weights[1:, None]), weights[:1, None])
        half = graph("Add", graph("MatMul", trend, root[1:]), root[:1])
        for block, w, rows in model.terms(j):
            square = graph.squares(graph("Sub", z, block.shift), block.root, model.centres[block.rows])
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
    x, *results = (helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["n", n]) for name, n in sizes.items())
    made = helper.make_graph(graph.nodes, "aero", [x], results, graph.constants)
    opset = helper.make_opsetid("", OPSET)
    proto = helper.make_model(made, opset_imports=[opset], ir_version=IR_VERSION, producer_name="skdgp")
    written, names = model.with_identifiers()
    lists = {"regressors": written.regressor_names, "outputs": written.outputs}
    lists |= {edge: tuple(map(repr, getattr(model.envelope, edge).tolist())) for edge in ("low", "high")}
    properties = {name: ",".join(values) for name, values in lists.items()}
    properties |= {"names": json.dumps(names), "content_hash": model.content_hash}
    helper.set_model_props(proto, properties)
    checker.check_model(proto)
    return proto


class _Graph:
    """Nodes and constants of a graph; called with an operator and its inputs, it returns the name of the result."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def __call__(self, kind: str, *inputs: str | Array, out: str | None = None, **attributes: Any) -> str:
        from onnx import helper

        out = f"v{len(self.nodes)}" if out is None else out
        names = [name if isinstance(name, str) else self.constant(name) for name in inputs]
        self.nodes.append(helper.make_node(kind, names, [out], **attributes))
        return out

    def constant(self, values: Array) -> str:
        """Return the name of a constant."""
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values), name))
        return name

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


def write_onnx(path: Path, model: PortableModel) -> Path:
    """Write the graph of a model."""
    path.write_bytes(onnx_model(model).SerializeToString())
    return path
