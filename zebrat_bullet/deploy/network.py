"""The network of an exported policy, by ONNX Runtime on one core; a file of anything but plain layers is refused."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import read_bytes, refusing, shown

OPERATIONS = ("ArgMax", "Clip", "Concat", "Elu", "Gather", "Gemm", "Relu", "Split", "Tanh")
"""Of ONNX, all that an exported policy is made of."""
MOST_BYTES = 64_000_000
REMEDY = "export the policy again with `zebrat export`"


class Network:
    """Observations in, actions in [-1, 1] out.

    Args:
        path: an ONNX file.
        size: numbers in an observation.
        sha256: the hash that the file must have, in hexadecimal digits.

    Raises:
        PolicyError: the file is another, is no ONNX file, or holds more than plain layers with these inputs and
            outputs; or ONNX Runtime is not installed.
    """

    def __init__(self, path: Path, size: int, sha256: str) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise PolicyError(
                "an exported policy runs with ONNX Runtime, which is not installed: pip install 'zebrat-bullet[deploy]'"
                " (on a robot: pip install onnxruntime)"
            ) from error
        data = read_bytes(path, PolicyError, MOST_BYTES)
        with refusing(path, PolicyError, "is not the network that policy.json names", REMEDY):
            if (found := hashlib.sha256(data).hexdigest()) != sha256:
                raise ValueError(f"its SHA-256 begins with {found[:12]}, not with {shown(sha256[:12])}")
            _check_plain(data)
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = options.inter_op_num_threads = 1  # threads cost more than so few layers
            options.log_severity_level = 4
            session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            _check_ends("input", session.get_inputs(), "observation", size)
            _check_ends("output", session.get_outputs(), "action", 2)
            self._session = session
            action = self(np.zeros((1, size), np.float32))
            if action.shape != (1, 2) or not np.isfinite(action).all():
                raise ValueError(f"its action for zeros is {shown(action.tolist())}")

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the (N, 2) float32 actions for (N, size) float32 observations."""
        actions: NDArray[np.float32] = self._session.run(None, {"observation": observations})[0]
        return actions


def _check_ends(which: str, ends: list[Any], name: str, size: int) -> None:
    found = [(end.name, end.type, end.shape[1:]) for end in ends]
    if found != [(name, "tensor(float)", [size])] or isinstance(ends[0].shape[0], int):
        raise ValueError(f"its {which} must be {name!r}, N x {size} float32, got {shown(found)}")


# Numbers of the fields in onnx.proto3, which never change their meaning.
_MODEL_GRAPH, _MODEL_FUNCTIONS = 7, 25
_GRAPH_NODE, _GRAPH_INITIALIZER, _GRAPH_SPARSE = 1, 5, 15
_NODE_OPERATION, _NODE_ATTRIBUTE, _NODE_DOMAIN = 4, 5, 7
_ATTRIBUTE_NO_NUMBERS = (5, 6, 10, 11, 22, 23)  # tensors and graphs
_TENSOR_EXTERNAL = (13, 14)


def _check_plain(model: bytes) -> None:
    """Refuse operations of other kinds, other domains, inner graphs and functions, and weights in other files."""
    for number, value in _fields(model):
        if number == _MODEL_FUNCTIONS:
            raise ValueError("it defines functions of its own")
        if number == _MODEL_GRAPH:
            for inner, part in _fields(value):
                if inner == _GRAPH_NODE:
                    _check_node(part)
                elif inner == _GRAPH_INITIALIZER and any(entry in _TENSOR_EXTERNAL for entry, _ in _fields(part)):
                    raise ValueError("its weights lie in another file")
                elif inner == _GRAPH_SPARSE:
                    raise ValueError("it holds sparse weights")


def _check_node(node: bytes) -> None:
    for number, value in _fields(node):
        if number == _NODE_OPERATION and value.decode() not in OPERATIONS:
            raise ValueError(f"it holds the operation {shown(value.decode())!r}; allowed are {', '.join(OPERATIONS)}")
        if number == _NODE_DOMAIN and value:
            raise ValueError(f"it holds an operation of the domain {shown(value.decode())!r}")
        if number == _NODE_ATTRIBUTE and any(inner in _ATTRIBUTE_NO_NUMBERS for inner, _ in _fields(value)):
            raise ValueError("an operation holds a graph, or weights of its own")


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield number and content of each field of a protocol buffer; of one that is a number, nothing."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind, size = key & 7, 0
        if kind == 0:
            _, at = _varint(message, at)
        elif kind in (1, 5):
            at += 8 if kind == 1 else 4
        elif kind == 2:
            size, at = _varint(message, at)
        else:
            raise ValueError("it is no protocol buffer")
        if at + size > len(message):
            raise ValueError("it ends in the middle")
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise ValueError("it ends in the middle")
        value |= (message[at] & 0x7F) << shift
        at += 1
        if not message[at - 1] & 0x80:
            return value, at
    raise ValueError("it is no protocol buffer")
