"""Writes a trained model as an ONNX file, for runtimes without numpy and torch.

The graph is made from the folded weights. Inputs are raw, in metres; outputs are the best estimate of the scaling and,
for a classifier, the probability of every level. The file is checked by the ONNX checker and, if onnxruntime is
installed, against the model's own prediction before it is put in place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cyclekit.errors import ModelError
from cyclekit.extras import need
from cyclekit.learning.networks.kinds import is_classifier
from cyclekit.learning.networks.trees import Trees
from cyclekit.storage.atomic import replaced
from cyclekit.text.numbers import scientific

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.learning.networks.saved import TrainedModel

TOLERANCE = 1e-5
"""Maximum difference between onnxruntime and the model's own prediction."""
_OPSET, _IR = 17, 9
_CHECKED_ROWS = 2000


def write_onnx(path: Path, model: TrainedModel) -> float | None:
    """Write `model` as an ONNX file.

    Args:
        path: File to write; an old one is replaced only by a checked new one.
        model: A feed-forward model whose inputs must all be known.

    Returns:
        The largest difference between onnxruntime and the model's own prediction; None if onnxruntime is not installed.

    Raises:
        MissingExtra: The package onnx is not installed.
        ModelError: The model is recurrent or has inputs that may be unknown, or the predictions differ.
    """
    if model.history != (1, 1) or model.weights.known:
        what = "a history" if model.history != (1, 1) else f"inputs that may be unknown {model.weights.known}"
        msg = f"a model with {what} cannot be written as ONNX yet"
        raise ModelError(msg, cure="Train a feed-forward network on logs in which the operator is always seen.")
    need("writing ONNX files", "onnx")
    import onnx

    content = _graph(model)
    onnx.checker.check_model(content)
    data = content.SerializeToString()
    off = _difference(data, model)
    if off is not None and off > TOLERANCE:
        msg = (
            f"{path}: onnxruntime predicts up to {scientific(off, 1)} apart from cyclekit, so the file was not written"
        )
        raise ModelError(msg)
    with replaced(path) as staging:
        staging.write_bytes(data)
    return off


def _graph(model: TrainedModel) -> Any:  # noqa: ANN401 - onnx has no types
    from onnx import TensorProto, helper, numpy_helper

    nodes: list[Any] = []
    constants: list[Any] = []
    weights = model.weights
    if isinstance(weights, Trees):
        raise ModelError("trees are no layers of a network")
    layers = weights.layers
    value = "positions"
    if weights.distance is not None:
        value = _with_distance(nodes, constants)
    for i, (weight, bias) in enumerate(layers):
        constants += [numpy_helper.from_array(weight, f"weight{i}"), numpy_helper.from_array(bias, f"bias{i}")]
        nodes.append(helper.make_node("Gemm", [value, f"weight{i}", f"bias{i}"], [f"linear{i}"]))
        value = f"linear{i}"
        kind = "Softmax" if i == weights.softmax_after else "Relu" if i < len(layers) - 1 else None
        if kind:
            out = "probabilities" if kind == "Softmax" and is_classifier(model.network) else f"active{i}"
            if kind == "Softmax":
                nodes.append(helper.make_node(kind, [value], [out], axis=1))
            else:
                nodes.append(helper.make_node(kind, [value], [out]))
            value = out
    outputs = [helper.make_tensor_value_info("scaling", TensorProto.FLOAT, [None, 1])]
    if is_classifier(model.network):
        levels = np.array(model.levels, np.float32)[:, None]
        constants.append(numpy_helper.from_array(levels, "levels"))
        nodes.append(helper.make_node("MatMul", [value, "levels"], ["mean"]))
        outputs.append(helper.make_tensor_value_info("probabilities", TensorProto.FLOAT, [None, len(levels)]))
        value = "mean"
    constants += [numpy_helper.from_array(np.array(v, np.float32), n) for n, v in (("low", 0.0), ("high", 1.0))]
    nodes.append(helper.make_node("Clip", [value, "low", "high"], ["scaling"]))
    inputs = [helper.make_tensor_value_info("positions", TensorProto.FLOAT, [None, len(model.inputs)])]
    graph = helper.make_graph(nodes, "cyclekit", inputs, outputs, constants)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR)
    helper.set_model_props(made, {"inputs": ",".join(model.inputs), "problem": model.problem})
    return made


def _with_distance(nodes: list[Any], constants: list[Any]) -> str:
    """Add the nodes that append ||x_r - x_h|| to the positions; return the name of the result."""
    from onnx import helper, numpy_helper

    apart = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    bounds = {"begin": [0], "end": [6], "columns": [1]}
    constants += [numpy_helper.from_array(np.array(v, np.int64), name) for name, v in bounds.items()]
    constants.append(numpy_helper.from_array(apart, "apart"))
    nodes += [
        helper.make_node("Slice", ["positions", "begin", "end", "columns"], ["both"]),
        helper.make_node("MatMul", ["both", "apart"], ["way"]),
        helper.make_node("ReduceL2", ["way"], ["distance"], axes=[1], keepdims=1),
        helper.make_node("Concat", ["positions", "distance"], ["features"], axis=1),
    ]
    return "features"


def _difference(data: bytes, model: TrainedModel) -> float | None:
    """Return the largest difference to onnxruntime over random rows; None if it is not installed."""
    try:
        import onnxruntime
    except ImportError:
        return None
    X = np.random.default_rng(0).uniform(-3, 3, (_CHECKED_ROWS, len(model.inputs))).astype(np.float32)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    scaling = session.run(["scaling"], {"positions": X})[0][:, 0]
    off = float(np.abs(scaling - model.predict(X)).max())
    if is_classifier(model.network):
        found = session.run(["probabilities"], {"positions": X})[0]
        off = max(off, float(np.abs(found - model.probabilities(X)).max()))
    return off
