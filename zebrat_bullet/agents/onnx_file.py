"""The network of a policy as ONNX, head included: observations in, actions in [-1, 1] out."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.task.observation import DISCRETE_COMMANDS

OPSET, IR_VERSION = 17, 8
"""Any ONNX Runtime from 1.12 on runs these."""


def onnx_of(agent: PolicyAgent) -> bytes:
    """Return a policy as an ONNX file of plain layers; the same policy gives the same bytes.

    Raises:
        PolicyError: the package `onnx` is not installed.
    """
    try:
        import onnx
    except ImportError as error:
        raise PolicyError("an export needs the package onnx: pip install 'zebrat-bullet[deploy]'") from error
    from onnx import TensorProto, helper, numpy_helper

    nodes, weights = _Nodes(agent).made()
    graph = helper.make_graph(
        [helper.make_node(kind, inputs, outputs, **how) for kind, inputs, outputs, how in nodes],
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["N", agent.observation.size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", 2])],
        [numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    model = helper.make_model(
        graph, producer_name="zebrat", ir_version=IR_VERSION, opset_imports=[helper.make_opsetid("", OPSET)]
    )
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString(deterministic=True)
    return data


_Node = tuple[str, Sequence[str], Sequence[str], dict[str, Any]]


class _Nodes:
    """Lays out the operations of a policy one after the other."""

    def __init__(self, agent: PolicyAgent) -> None:
        self._agent = agent
        self._nodes: list[_Node] = []
        self._weights: dict[str, NDArray] = {}

    def made(self) -> tuple[list[_Node], dict[str, NDArray]]:
        """Return kind, inputs, outputs and attributes of each node, and the constants by name."""
        at = "observation"
        for i, (weight, bias) in enumerate(self._agent.layers):
            inputs = at, self._constant(f"{i}.weight", weight), self._constant(f"{i}.bias", bias)
            at = self._add("Gemm", inputs, f"layer_{i}", transB=1)
            if i + 1 < len(self._agent.layers):
                activation = self._agent.activations[i]
                ends = self._ends() if activation == "clip" else []
                at = self._add(activation.capitalize(), [at, *ends], f"hidden_{i}")
        getattr(self, f"_{self._agent.head}")(at)
        return self._nodes, self._weights

    def _tanh(self, output: str) -> None:
        self._add("Tanh", [output], "action")

    def _clip(self, output: str) -> None:
        self._add("Clip", [output, *self._ends()], "action")

    def _argmax(self, output: str) -> None:
        commands = self._constant("commands", np.array(DISCRETE_COMMANDS, np.float32))
        largest = self._add("ArgMax", [output], "largest", axis=1, keepdims=0)
        self._add("Gather", [commands, largest], "action", axis=0)

    def _grid(self, output: str) -> None:
        names = "speed", "steering"
        sizes = self._constant("sizes", np.array([len(values) for values in self._agent.grid], np.int64))
        parts = [f"{name}_outputs" for name in names]
        self._nodes.append(("Split", [output, sizes], parts, {"axis": 1}))
        chosen = []
        for name, part, values in zip(names, parts, self._agent.grid, strict=True):
            choices = self._constant(f"{name}s", np.array(values, np.float32))
            largest = self._add("ArgMax", [part], f"largest_{name}", axis=1, keepdims=1)
            chosen.append(self._add("Gather", [choices, largest], name, axis=0))
        self._add("Concat", chosen, "action", axis=1)

    def _ends(self) -> list[str]:
        """Return the names of the two ends of a clip."""
        return [self._constant(name, np.array(value, np.float32)) for name, value in (("least", -1.0), ("most", 1.0))]

    def _constant(self, name: str, values: NDArray) -> str:
        self._weights[name] = np.ascontiguousarray(values)
        return name

    def _add(self, kind: str, inputs: Sequence[str], output: str, **attributes: int) -> str:
        self._nodes.append((kind, list(inputs), [output], attributes))
        return output
