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
    """Make a small network with every part that an honest one has: weights, a constant, a branch, attributes."""
    value = helper.make_tensor_value_info("y", TensorProto.FLOAT, [CONTRACT.outputs])
    chosen = helper.make_graph([helper.make_node("Identity", ["w"], ["y"])], "chosen", [], [value])
    constant = helper.make_tensor("c", TensorProto.BOOL, [], np.array(True).tobytes(), raw=True)
    nodes = [
        helper.make_node("Constant", [], ["c"], value=constant),
        helper.make_node("If", ["c"], ["chosen"], then_branch=chosen, else_branch=chosen),
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
    assert [node.op_type for node in read.node] == ["Constant", "If", "Conv", "GlobalMaxPool", "Einsum"]
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


def other_file(tensor: Any) -> None:
    """Let the values of a tensor lie in another file."""
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")


CHANGES: dict[str, Callable[[Any], object]] = {
    "weights in another file": lambda model: other_file(model.graph.initializer[0]),
    "a constant in another file": lambda model: other_file(model.graph.node[0].attribute[0].t),
    "a function of its own": function,
    "an operator of a vendor": lambda model: setattr(model.graph.node[2], "domain", "com.microsoft"),
    "an operator of a vendor in a branch": lambda model: setattr(
        model.graph.node[1].attribute[0].g.node[0], "domain", "com.microsoft"
    ),
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
    "too many nodes": lambda model: model.graph.node.extend([model.graph.node[2]] * 100_001),
}


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
