"""Promise: whatever a confined process sends as `model.onnx`, what is written is a network alone, and runs nothing."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from training_jobs import CONTRACT

from tacevo.export.onnx_file import INPUT, OPSET, OUTPUT, rewritten

#: What must not come out, wherever it was.
TEXT = "__import__('os').system('id')"

SHAPE: list[str | int | None] = ["n", CONTRACT.in_channels, CONTRACT.image_size, CONTRACT.image_size]


def network() -> Any:
    """Make a small network with every part that an honest one has: weights, a constant, attributes."""
    constant = helper.make_tensor("c", TensorProto.BOOL, [], np.array(True).tobytes(), raw=True)
    nodes = [
        helper.make_node("Constant", [], ["c"], value=constant),
        helper.make_node("Where", ["c", "w", "w"], ["chosen"]),
        helper.make_node("Conv", [INPUT, "k"], ["seen"], strides=[2, 2], auto_pad="VALID"),
        helper.make_node("GlobalMaxPool", ["seen"], ["largest"]),
        helper.make_node("Einsum", ["largest", "chosen"], [OUTPUT], equation="nabc,k->nk"),
    ]
    weights = np.ones(CONTRACT.outputs, np.float32).tobytes()
    kernel = np.ones([1, CONTRACT.in_channels, 3, 3], np.float32)
    graph = helper.make_graph(
        nodes,
        "main_graph",
        [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, SHAPE)],
        [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["n", CONTRACT.outputs])],
        initializer=[
            helper.make_tensor("w", TensorProto.FLOAT, [CONTRACT.outputs], weights, raw=True),
            helper.make_tensor("k", TensorProto.FLOAT, kernel.shape, kernel.tobytes(), raw=True),
        ],
    )
    model = helper.make_model(graph, ir_version=10, opset_imports=[helper.make_opsetid("", OPSET)])
    rewritten(model.SerializeToString(), CONTRACT)  # it is honest, so what is refused below is so for its change
    return model


def messages(message: Any) -> Iterator[Any]:
    """Yield a message and all that it holds."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in [value] if hasattr(value, "ListFields") else value:
                yield from messages(part)


def texts() -> list[tuple[int, str]]:
    """List every field of every message of the network that may hold a text, set or not."""
    return [
        (number, field.name)
        for number, message in enumerate(messages(network()))
        for field in message.DESCRIPTOR.fields
        if field.cpp_type == field.CPPTYPE_STRING
    ]


def test_honest_file_keeps_its_network() -> None:
    """What is read again is written in the same bytes."""
    written = rewritten(network().SerializeToString(), CONTRACT)
    onnx.checker.check_model(written)
    assert rewritten(written, CONTRACT) == written
    read = onnx.load_from_string(written).graph
    assert [node.op_type for node in read.node] == ["Constant", "Where", "Conv", "GlobalMaxPool", "Einsum"]
    assert [value.name for value in (*read.input, *read.output)] == [INPUT, OUTPUT]


@pytest.mark.parametrize(("number", "name"), texts())
def test_no_text_comes_out_of_a_file(number: int, name: str) -> None:
    """Whatever field of whatever message held it: it is refused, or left out."""
    model = network()
    message = list(messages(model))[number]
    text: Any = TEXT.encode() if name in {"s", "strings", "raw_data", "string_data"} else TEXT
    is_list = hasattr(getattr(message, name), "append")
    getattr(message, name).append(text) if is_list else setattr(message, name, text)
    file = model.SerializeToString()
    assert TEXT.encode() in file
    try:
        assert TEXT.encode() not in rewritten(file, CONTRACT)
    except ValueError as error:
        assert "expected" in str(error)  # noqa: PT017 - either is right


def test_unknown_fields_are_left_out() -> None:
    """As a later format would have them."""
    field = b"\xfa\x7f" + bytes([len(TEXT)]) + TEXT.encode()  # of number 2047
    file = network().SerializeToString() + field
    assert TEXT.encode() not in rewritten(file, CONTRACT)


def function(model: Any) -> None:
    """Add an operator of its own, whose body is standard."""
    node = helper.make_node("Relu", ["x"], ["y"])
    model.functions.append(helper.make_function("own", "f", ["x"], ["y"], [node], [helper.make_opsetid("", OPSET)]))
    model.graph.node[2].domain, model.graph.node[2].op_type = "own", "f"


def branch(model: Any) -> None:
    """Add a graph within the graph."""
    value = helper.make_tensor_value_info("y", TensorProto.FLOAT, [CONTRACT.outputs])
    graph = helper.make_graph([helper.make_node("Identity", ["w"], ["y"])], "chosen", [], [value])
    model.graph.node.append(helper.make_node("If", ["c"], ["z"], then_branch=graph, else_branch=graph))


def other_file(tensor: Any) -> None:
    """Let the values of a tensor lie in another file."""
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")


CHANGES: dict[str, Callable[[Any], object]] = {
    "weights in another file": lambda model: other_file(model.graph.initializer[0]),
    "a constant in another file": lambda model: other_file(model.graph.node[0].attribute[0].t),
    "a function of its own": function,
    "an operator of a vendor": lambda model: setattr(model.graph.node[2], "domain", "com.microsoft"),
    "a branch": branch,
    "a loop without a graph": lambda model: setattr(model.graph.node[1], "op_type", "Loop"),
    "drawn numbers": lambda model: model.graph.node.append(helper.make_node("RandomNormalLike", ["w"], ["drawn"])),
    "a dropout": lambda model: model.graph.node.append(helper.make_node("Dropout", ["w", "w", "c"], ["dropped"])),
    "a sequence": lambda model: model.graph.node.append(helper.make_node("SequenceConstruct", ["w"], ["s"])),
    "texts": lambda model: model.graph.node.append(helper.make_node("StringNormalizer", ["w"], ["s"])),
    "a graph beside the value of an attribute": lambda model: setattr(
        model.graph.node[4].attribute[0].g, "name", "hidden"
    ),
    "a number beside the value of an attribute": lambda model: setattr(model.graph.node[4].attribute[0], "i", 7),
    "an attribute twice": lambda model: model.graph.node[4].attribute.append(model.graph.node[4].attribute[0]),
    "a value twice": lambda model: model.graph.node.append(model.graph.node[3]),
    "weights twice": lambda model: model.graph.initializer.append(model.graph.initializer[0]),
    "a value called as the input": lambda model: model.graph.node[1].output.__setitem__(0, INPUT),
    "too many axes": lambda model: model.graph.initializer[0].dims.extend([1] * 8),
    "axes whose product takes a minute": lambda model: model.graph.initializer[0].dims.extend([2**62] * 400_000),
    "an axis that is too long": lambda model: model.graph.initializer[0].dims.extend([2**31, 0]),
    "no operator": lambda model: setattr(model.graph.node[2], "op_type", "PyOp"),
    "an attribute of another operator": lambda model: model.graph.node[4].attribute.append(
        helper.make_attribute("script", "x")
    ),
    "an attribute of another type": lambda model: (
        model.graph.node[4].attribute[0].CopyFrom(helper.make_attribute("equation", 1))
    ),
    "operators of a domain": lambda model: model.opset_import.append(helper.make_opsetid("own", 1)),
    "operators of another number": lambda model: setattr(model.opset_import[0], "version", OPSET + 1),
    "another format": lambda model: setattr(model, "ir_version", 2**31),
    "training": lambda model: model.training_info.add(),
    "sparse weights": lambda model: model.graph.sparse_initializer.add(),
    "a tensor of texts": lambda model: model.graph.initializer.append(
        TensorProto(name="t", data_type=TensorProto.STRING, dims=[1], string_data=[b"x"])
    ),
    "a tensor larger than its bytes": lambda model: model.graph.initializer[0].dims.append(2**40),
    "a tensor of a negative size": lambda model: model.graph.initializer[0].dims.__setitem__(0, -CONTRACT.outputs),
    "a second input": lambda model: model.graph.input.append(model.graph.input[0]),
    "another input": lambda model: setattr(model.graph.input[0], "name", "pixels"),
    "no output": lambda model: model.graph.ClearField("output"),
}

#: Empty messages, two bytes each, by the message that has them, and its field.
MANY: dict[str, tuple[Any, str]] = {
    "notes": (onnx.ModelProto, "metadata_props"),
    "sets of operators": (onnx.ModelProto, "opset_import"),
    "nodes": (onnx.GraphProto, "node"),
    "weights": (onnx.GraphProto, "initializer"),
    "inputs": (onnx.GraphProto, "input"),
    "described values": (onnx.GraphProto, "value_info"),
    "inputs of a node": (onnx.NodeProto, "input"),
    "attributes": (onnx.NodeProto, "attribute"),
}


def varint(number: int) -> bytes:
    """Write a number as Protocol Buffers do."""
    return bytes([number & 127 | 128]) + varint(number >> 7) if number > 127 else bytes([number])


def within(kind: Any, part: bytes) -> bytes:
    """Put a part of a message of some kind, as bytes, into a model, as bytes."""
    for inner, outer, number in ((onnx.NodeProto, onnx.GraphProto, 1), (onnx.GraphProto, onnx.ModelProto, 7)):
        if kind is inner:
            kind, part = outer, bytes([number << 3 | 2]) + varint(len(part)) + part
    return part


@pytest.mark.parametrize("parts", MANY)
def test_parts_are_counted_before_they_are_read(parts: str) -> None:
    """Two bytes of each take a hundred in memory; notes count, too, though they are left out."""
    kind, name = MANY[parts]
    tag = bytes([kind.DESCRIPTOR.fields_by_name[name].number << 3 | 2, 0])
    file = network().SerializeToString() + within(kind, tag * 500_001)
    with pytest.raises(ValueError, match="expected at most 500000 parts"):
        rewritten(file, CONTRACT)


def test_numbers_in_a_row_are_counted() -> None:
    """They take a byte each in the file, and eight in memory."""
    model = network()
    model.graph.node[2].attribute[0].ints.extend([1] * 500_001)
    with pytest.raises(ValueError, match="expected at most 500000 parts"):
        rewritten(model.SerializeToString(), CONTRACT)


def test_names_are_given_anew() -> None:
    """A name of an honest network may be any text, as those of an `nn.ModuleDict`; it is no text of the file."""
    model = network()
    odd = "../" + TEXT
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = [name if name in {INPUT, OUTPUT} else odd + name for name in names]
    for tensor in model.graph.initializer:
        tensor.name = odd + tensor.name
    file = rewritten(model.SerializeToString(), CONTRACT)
    assert file == rewritten(network().SerializeToString(), CONTRACT)
    onnx.checker.check_model(file, full_check=True)


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_no_part_of_a_network_is_refused(change: str) -> None:
    """In branches and constants, too: whoever runs the file would read or run what it names."""
    model = network()
    CHANGES[change](model)
    with pytest.raises(ValueError, match="expected"):
        rewritten(model.SerializeToString(), CONTRACT)


@pytest.mark.parametrize("file", [b"", b"PK\x03\x04", b"\xff", b"\x80\x04.", b"\x3a\xff\xff\xff\xff\x0f"])
def test_other_files_are_refused(file: bytes) -> None:
    """An empty one, an archive, a pickle, lengths that lie."""
    with pytest.raises(ValueError, match="expected"):
        rewritten(file, CONTRACT)
