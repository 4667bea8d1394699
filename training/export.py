"""The net as ONNX: the same operations as `training.proposer.maps`, with the sigmoid of the first map at the end."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from gateway.vision.detect.robust.proposer import CELL, CHANNELS, HEIGHT, WIDTH

OPSET, IR_VERSION = 13, 8


def to_onnx(
    weights: Mapping[str, np.ndarray], layers: Sequence[tuple[str, int, int, int, int, int]], recipe: Mapping[str, str]
) -> bytes:
    """`recipe` becomes the file's metadata."""
    nodes: list[onnx.NodeProto] = []
    geometry = {name: (side, stride, wide) for name, _, _, side, stride, wide in layers}

    def add(kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"{kind.lower()}{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **attributes))
        return name

    def conv(name: str, x: str) -> str:
        side, stride, wide = geometry[name]
        return add(
            "Conv", x, f"{name}.w", f"{name}.b", kernel_shape=[side, side], strides=[stride, stride],
            dilations=[wide, wide], pads=[wide * (side // 2)] * 4,
        )  # fmt: skip

    def relu(x: str) -> str:
        return add("Relu", x)

    def more(name: str, x: str) -> str:
        return add("Add", x, relu(conv(name, x)))

    def twice(x: str) -> str:
        return add(
            "Resize", x, "", "twice", mode="nearest", coordinate_transformation_mode="asymmetric", nearest_mode="floor"
        )

    at4 = more("at4", relu(conv("down4", relu(conv("stem", "picture")))))
    at8 = more("at8", relu(conv("down8", at4)))
    at16 = more("wide16", more("at16", relu(conv("down16", at8))))
    at32 = more("at32", relu(conv("down32", at16)))
    at16 = add("Add", at16, twice(conv("up16", at32)))
    at8 = relu(add("Add", conv("side8", at8), twice(conv("side16", at16))))
    at8 = more("join8", at8)
    at4 = relu(add("Add", conv("side4", at4), twice(conv("up8", at8))))
    head = conv("head", more("join", at4))
    nodes.append(helper.make_node("Split", [head, "parts"], ["logit", "rest"], name="split", axis=1))
    nodes.append(helper.make_node("Concat", [add("Sigmoid", "logit"), "rest"], ["maps"], name="maps", axis=1))
    constants = {**weights, "twice": np.array([1, 1, 2, 2], np.float32), "parts": np.array([1, 3], np.int64)}
    shape = [1, 4, HEIGHT // CELL, WIDTH // CELL]
    graph = helper.make_graph(
        nodes,
        "proposer",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, CHANNELS, HEIGHT, WIDTH])],
        [helper.make_tensor_value_info("maps", TensorProto.FLOAT, shape)],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION,
        producer_name="training.proposer",
    )  # fmt: skip
    helper.set_model_props(model, dict(recipe))
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())
