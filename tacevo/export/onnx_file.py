"""The file `model.onnx`: read as data, compared with a closed list of what a network needs, and written anew.

It comes from a process that ran a candidate's class, so its bytes may be anything. What is written holds nothing but
numbers, standard operators with their own attributes, and names that are given here: no note, no function, no operator
of another domain, no name of another file, nothing that draws, loops or branches. Its parts are counted before they are
read, since a part of two bytes takes a hundred in memory. Reading evaluates nothing.
"""

import importlib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from tacevo.records import Contract

#: The version of the ONNX operators.
OPSET = 18

#: The names of input and output.
INPUT, OUTPUT = "images", "outputs"

#: Versions of the format that readers of this opset know.
_FORMATS = range(8, 14)

#: Parts of a file, at most: fields of messages, and numbers that stand in a row. With the notes that torch makes, an
#: operator has some 60, and the largest honest networks have some thousand operators.
_MOST_PARTS = 500_000

#: Messages within messages, at most; the values of a constant are at 7.
_DEEPEST = 20

#: Axes of a tensor, and what an axis is below.
_MOST_AXES, _LONGEST = 8, 2**31

#: Operators that no trained network needs: those with graphs of their own, and what draws numbers or holds sequences,
#: optional values or texts.
_LEFT_OUT = re.compile(
    r"If|Loop|Scan|\w*Sequence\w*|Optional\w*|Random\w*|Bernoulli|Multinomial|Dropout|String\w*|TfIdf\w*"
)

#: The operators that work on no sequence of values, though they are called so.
_NOT_LEFT_OUT = frozenset({"ReverseSequence"})

#: The fields of every message that are written anew. Other fields are refused, but for those of `_NOTES`.
_KEPT: Mapping[str, frozenset[str]] = {
    "ModelProto": frozenset({"ir_version", "opset_import", "graph"}),
    "OperatorSetIdProto": frozenset({"domain", "version"}),
    "GraphProto": frozenset({"name", "node", "initializer", "input", "output"}),
    "NodeProto": frozenset({"input", "output", "op_type", "domain", "attribute"}),
    "AttributeProto": frozenset({"name", "type", "f", "i", "s", "t", "floats", "ints", "strings"}),
    "TensorProto": frozenset({"name", "dims", "data_type", "raw_data"}),
    "ValueInfoProto": frozenset({"name", "type"}),
    "TypeProto": frozenset({"tensor_type"}),
    "Tensor": frozenset({"elem_type", "shape"}),
    "TensorShapeProto": frozenset({"dim"}),
    "Dimension": frozenset({"dim_value", "dim_param"}),
}

#: The field that holds the value of an attribute, by its type.
_VALUES: Mapping[int, str] = {1: "f", 2: "i", 3: "s", 4: "t", 6: "floats", 7: "ints", 8: "strings"}

#: The fields that say nothing to a runtime, and name modules and directories of the machine: they are left out.
_NOTES = frozenset({"doc_string", "metadata_props", "producer_name", "producer_version", "value_info"})

#: Texts among the attributes, such as `NOTSET` and `bij,bjk->bik`.
_TEXT = re.compile(rb"[A-Za-z0-9_,.> -]{0,200}")


def rewritten(file: bytes, contract: Contract) -> bytes:
    """Write an ONNX file anew from what was read of it: one input and one output, as the contract says.

    Values have other names then, `v0` and so on.

    Raises:
        ValueError: it holds something else than a network needs, or it is not such a file.
    """
    onnx: Any = importlib.import_module("onnx")  # of the extra
    _count_parts(memoryview(file), onnx.ModelProto.DESCRIPTOR)
    try:
        read = onnx.ModelProto.FromString(file)
    except Exception as error:  # protobuf's own class, which is not always a ValueError
        raise ValueError(f"expected an ONNX model; got another file: {str(error)[:100]}") from error
    model = onnx.ModelProto()
    _write(read, model, _checks(onnx))
    if [(one.domain, one.version) for one in model.opset_import] != [("", OPSET)]:
        raise ValueError(f"expected operators of ONNX {OPSET} alone; got {str(list(model.opset_import[:5]))[:100]}")
    if model.ir_version not in _FORMATS:
        raise ValueError(f"expected a version of the format in {_FORMATS}; got {model.ir_version}")
    names = [[value.name for value in values[:5]] for values in (model.graph.input, model.graph.output)]
    if names != [[INPUT], [OUTPUT]]:
        raise ValueError(f"expected the input {INPUT} and the output {OUTPUT}; got {str(names)[:200]}")
    _rename(model.graph)
    size, kind = contract.image_size, onnx.TensorProto.FLOAT
    described = [(model.graph.input, INPUT, [contract.in_channels, size, size])]
    described += [(model.graph.output, OUTPUT, [contract.outputs])]
    for values, name, shape in described:
        values[0].CopyFrom(onnx.helper.make_tensor_value_info(name, kind, ["batch", *shape]))
    model.graph.name, model.producer_name = "network", "tacevo"
    written: bytes = model.SerializeToString(deterministic=True)
    return written


def _count_parts(file: memoryview, kind: Any) -> None:
    """Count the parts of a file in its bytes, before anything is made of them.

    Raises:
        ValueError: they are too many, or too deep; or these are not the bytes of such a file.
    """
    count = 0
    waiting = [(file, kind, 1)]
    while waiting:
        message, kind, depth = waiting.pop()
        if depth > _DEEPEST:
            raise ValueError(f"expected at most {_DEEPEST} messages within each other; got more")
        for number, value in _fields(message):
            field = kind.fields_by_number.get(number)
            count += 1
            if field is not None and value:
                if field.message_type is not None:
                    waiting.append((value, field.message_type, depth + 1))
                elif field.type not in {field.TYPE_BYTES, field.TYPE_STRING}:  # numbers in a row, a byte each or more
                    count += len(value)
            if count > _MOST_PARTS:
                raise ValueError(f"expected at most {_MOST_PARTS} parts of a network; got more")


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview | None]]:
    """Yield number and bytes of each field of a message, as Protocol Buffers write them; None for a single number."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        value, end = None, at
        match tag & 7:
            case 0:
                _, end = _varint(message, at)
            case 1:
                end = at + 8
            case 2:
                length, at = _varint(message, at)
                end = at + length
                value = message[at:end]
            case 5:
                end = at + 4
            case wire:
                raise ValueError(f"expected an ONNX model; got a field of the kind {wire}")
        if end > len(message):
            raise ValueError("expected an ONNX model; got a part of one")
        yield tag >> 3, value
        at = end


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Read a number of at most ten bytes; return it with the place behind it."""
    if at < len(message) and message[at] < 128:  # most are of one byte
        return message[at], at + 1
    value = 0
    for index, byte in enumerate(message[at : at + 10]):
        value |= (byte & 127) << 7 * index
        if byte < 128:
            return value, at + index + 1
    raise ValueError("expected an ONNX model; got a number that does not end")


_Checks = Mapping[str, Callable[[Any], None]]


def _write(read: Any, target: Any, checks: _Checks) -> None:
    """Copy a message into an empty one, field by field, and compare it with what its kind may hold."""
    kind = type(read).__name__
    for field, value in read.ListFields():
        if field.name in _NOTES or (kind, field.name) == ("NodeProto", "name"):
            continue
        if field.name not in _KEPT.get(kind, ()):
            raise ValueError(f"expected a network alone; got {kind}.{field.name}")
        if kind == "AttributeProto" and field.name not in {"name", "type", _VALUES.get(read.type)}:
            raise ValueError(f"expected the value of an attribute of type {read.type}; got {field.name} beside it")
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


def _checks(onnx: Any) -> _Checks:
    """Return what a message of each kind is compared with."""
    numbers = {getattr(onnx.TensorProto, name) for name in ("FLOAT", "DOUBLE", "FLOAT16", "BOOL")}
    numbers |= {getattr(onnx.TensorProto, f"{sign}INT{bits}") for sign in ("", "U") for bits in (8, 16, 32, 64)}

    def check_tensor(tensor: Any) -> None:
        if tensor.data_type not in numbers:
            raise ValueError(f"expected a tensor of numbers; got type {tensor.data_type}")
        if len(tensor.dims) > _MOST_AXES or not all(0 <= length < _LONGEST for length in tensor.dims):
            shape = f"{len(tensor.dims)} axes, {list(tensor.dims[:_MOST_AXES])}"
            raise ValueError(f"expected at most {_MOST_AXES} axes, each of 0 or more and below {_LONGEST}; got {shape}")
        size = onnx.helper.tensor_dtype_to_np_dtype(tensor.data_type).itemsize
        if math.prod(tensor.dims) * size != len(tensor.raw_data):
            raise ValueError(f"expected the bytes of a tensor {list(tensor.dims)}; got {len(tensor.raw_data)}")

    def check_node(node: Any) -> None:
        node.domain = "" if node.domain == "ai.onnx" else node.domain
        is_left_out = _LEFT_OUT.fullmatch(node.op_type) and node.op_type not in _NOT_LEFT_OUT
        if node.domain or is_left_out or not onnx.defs.has(node.op_type, OPSET, ""):
            got = f"{node.domain[:100]}.{node.op_type[:100]}"
            raise ValueError(f"expected an operator of ONNX {OPSET} that a trained network needs; got {got}")
        known = onnx.defs.get_schema(node.op_type, OPSET, "").attributes
        names = [one.name for one in node.attribute]
        if len(set(names)) != len(names):
            raise ValueError(f"expected each attribute of {node.op_type} once; got {str(names[:10])[:200]}")
        for one in node.attribute:
            if one.name not in known or one.type != int(known[one.name].type):
                raise ValueError(f"expected an attribute of {node.op_type}; got {one.name[:100]!r}, type {one.type}")

    def check_attribute(one: Any) -> None:
        if one.HasField("t"):
            one.t.ClearField("name")
        for text in [one.s, *one.strings]:
            if not _TEXT.fullmatch(text):
                raise ValueError(f"expected a word for the attribute {one.name[:100]!r}; got {text[:100]!r}")

    return {"TensorProto": check_tensor, "NodeProto": check_node, "AttributeProto": check_attribute}


def _rename(graph: Any) -> None:
    """Give all values names of their own, since theirs may be any text; input and output keep theirs.

    Raises:
        ValueError: two values have one name.
    """
    given = {"": "", INPUT: INPUT, OUTPUT: OUTPUT}  # "" is an input that is left out
    made = {INPUT}
    for tensor in graph.initializer:
        tensor.name = _new(tensor.name, given, made)
    for node in graph.node:
        node.input[:] = [given.setdefault(name, f"v{len(given) - 3}") for name in node.input]
        node.output[:] = [_new(name, given, made) if name else "" for name in node.output]


def _new(name: str, given: dict[str, str], made: set[str]) -> str:
    """Return the new name of a value where it is made."""
    if name in made or not name:
        raise ValueError(f"expected values with names of their own; got {name[:100]!r} again, or none")
    made.add(name)
    return given.setdefault(name, f"v{len(given) - 3}")
