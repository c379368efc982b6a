"""The file `model.onnx`: read as data, compared with a closed list of what a network needs, and written anew.

It comes from a process that ran a candidate's class, so its bytes may be anything. What is written holds nothing but
numbers, standard operators with their own attributes, and names of plain letters: no note, no function, no operator of
another domain, no name of another file. Reading evaluates nothing.
"""

import importlib
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from tacevo.records import Contract

#: Of the ONNX operators.
OPSET = 18

#: What input and output are called.
INPUT, OUTPUT = "images", "outputs"

#: Versions of the format that readers of this opset know.
_FORMATS = range(8, 14)

#: Nodes of a file, at most; the largest honest network has some thousands.
_MOST_NODES = 100_000

#: Of every message what is written anew. Other fields are refused, but for those of `_NOTES`.
_KEPT: Mapping[str, frozenset[str]] = {
    "ModelProto": frozenset({"ir_version", "opset_import", "graph"}),
    "OperatorSetIdProto": frozenset({"domain", "version"}),
    "GraphProto": frozenset({"name", "node", "initializer", "input", "output"}),
    "NodeProto": frozenset({"input", "output", "op_type", "domain", "attribute"}),
    "AttributeProto": frozenset(
        {"name", "type", "f", "i", "s", "t", "g", "floats", "ints", "strings", "tensors", "graphs"}
    ),
    "TensorProto": frozenset({"name", "dims", "data_type", "raw_data"}),
    "ValueInfoProto": frozenset({"name", "type"}),
    "TypeProto": frozenset({"tensor_type"}),
    "Tensor": frozenset({"elem_type", "shape"}),
    "TensorShapeProto": frozenset({"dim"}),
    "Dimension": frozenset({"dim_value", "dim_param"}),
}

#: What says nothing to a runtime, and names modules and directories of the machine: it is left out.
_NOTES = frozenset({"doc_string", "metadata_props", "producer_name", "producer_version", "value_info"})

#: Names of values and of graphs, as torch gives them; "" is an input that is left out.
_NAME = re.compile(r"[\w.:/-]{0,500}", re.ASCII)

#: Texts among the attributes, such as `NOTSET` and `bij,bjk->bik`.
_TEXT = re.compile(rb"[A-Za-z0-9_,.> -]{0,200}")


def rewritten(file: bytes, contract: Contract) -> bytes:
    """Write an ONNX file anew from what was read of it: one input and one output, as the contract says.

    Raises:
        ValueError: it holds something else than a network needs, or it is not such a file.
    """
    onnx: Any = importlib.import_module("onnx")  # of the extra
    try:
        read = onnx.ModelProto.FromString(file)
    except Exception as error:  # protobuf's own class, which is not always a ValueError
        raise ValueError(f"expected an ONNX model; got another file: {str(error)[:100]}") from error
    model, left = onnx.ModelProto(), [_MOST_NODES]
    checks = _checks(onnx, left)
    _write(read, model, checks)
    if [(one.domain, one.version) for one in model.opset_import] != [("", OPSET)]:
        raise ValueError(f"expected operators of ONNX {OPSET} alone; got {str(list(model.opset_import))[:100]}")
    if model.ir_version not in _FORMATS:
        raise ValueError(f"expected a version of the format in {_FORMATS}; got {model.ir_version}")
    names = [[value.name for value in values] for values in (model.graph.input, model.graph.output)]
    if names != [[INPUT], [OUTPUT]]:
        raise ValueError(f"expected the input {INPUT} and the output {OUTPUT}; got {str(names)[:200]}")
    size, kind = contract.image_size, onnx.TensorProto.FLOAT
    described = [(model.graph.input, INPUT, [contract.in_channels, size, size])]
    described += [(model.graph.output, OUTPUT, [contract.outputs])]
    for values, name, shape in described:
        values[0].CopyFrom(onnx.helper.make_tensor_value_info(name, kind, ["batch", *shape]))
    model.graph.name, model.producer_name = "network", "tacevo"
    written: bytes = model.SerializeToString(deterministic=True)
    return written


_Checks = Mapping[str, Callable[[Any], None]]


def _write(read: Any, target: Any, checks: _Checks) -> None:
    """Copy a message into an empty one, field by field, and compare it with what its kind may hold."""
    kind = type(read).__name__
    for field, value in read.ListFields():
        if field.name in _NOTES or (kind, field.name) == ("NodeProto", "name"):
            continue
        if field.name not in _KEPT.get(kind, ()):
            raise ValueError(f"expected a network alone; got {kind}.{field.name}")
        if field.message_type is None:
            is_one = isinstance(value, int | float | str | bytes)
            setattr(target, field.name, value) if is_one else getattr(target, field.name).extend(value)
        elif hasattr(value, "ListFields"):
            getattr(target, field.name).SetInParent()
            _write(value, getattr(target, field.name), checks)
        else:
            for part in value:
                _write(part, getattr(target, field.name).add(), checks)
    if kind in checks:
        checks[kind](target)


def _checks(onnx: Any, left: list[int]) -> _Checks:
    """Return what a message of each kind is compared with; `left` counts the nodes that may still come."""
    numbers = {getattr(onnx.TensorProto, name) for name in ("FLOAT", "DOUBLE", "FLOAT16", "BOOL")}
    numbers |= {getattr(onnx.TensorProto, f"{sign}INT{bits}") for sign in ("", "U") for bits in (8, 16, 32, 64)}

    def check_tensor(tensor: Any) -> None:
        _check_names([tensor.name])
        if tensor.data_type not in numbers:
            raise ValueError(f"expected a tensor of numbers; got type {tensor.data_type}")
        size = onnx.helper.tensor_dtype_to_np_dtype(tensor.data_type).itemsize
        if min(tensor.dims, default=0) < 0 or math.prod(tensor.dims) * size != len(tensor.raw_data):
            raise ValueError(f"expected the bytes of a tensor {list(tensor.dims)}; got {len(tensor.raw_data)}")

    def check_node(node: Any) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise ValueError(f"expected at most {_MOST_NODES} nodes; got more")
        _check_names([*node.input, *node.output])
        node.domain = "" if node.domain == "ai.onnx" else node.domain
        if node.domain or not onnx.defs.has(node.op_type, OPSET, ""):
            raise ValueError(f"expected an operator of ONNX {OPSET}; got {node.domain[:100]}.{node.op_type[:100]}")
        known = onnx.defs.get_schema(node.op_type, OPSET, "").attributes
        for one in node.attribute:
            if one.name not in known or one.type != int(known[one.name].type):
                raise ValueError(f"expected an attribute of {node.op_type}; got {one.name[:100]!r}, type {one.type}")

    def check_attribute(one: Any) -> None:
        for text in [one.s, *one.strings]:
            if not _TEXT.fullmatch(text):
                raise ValueError(f"expected a word for the attribute {one.name[:100]!r}; got {text[:100]!r}")

    return {
        "TensorProto": check_tensor,
        "NodeProto": check_node,
        "AttributeProto": check_attribute,
        "ValueInfoProto": lambda value: _check_names([value.name]),
        "GraphProto": lambda graph: _check_names([graph.name]),
        "Dimension": lambda dimension: _check_names([dimension.dim_param]),
    }


def _check_names(names: list[str]) -> None:
    for name in names:
        if not _NAME.fullmatch(name):
            raise ValueError(f"expected a name of letters, digits and _ . : / -; got {name[:100]!r}")
