"""Which layers, functions and tensor operations a network's source uses, and all that recorded answers use.

A form is one word: the gate's spelling of an operation (`conv2d` for `nn.Conv2d` and `F.conv2d`), with the shapes of a
convolution apart, because each takes other code.
"""

import ast
from collections.abc import Iterator

import torch
from gate_cases import completion, contract, examples, extracted

from tacevo.gate.operations import is_factory, operation
from tacevo.records import Rejection

#: Calls that compute nothing: containers, and what only looks at a tensor.
_NOTHING = frozenset(["module", "sequential", "modulelist", "parameter", "size", "dim", "numel", "item"])


def forms(source: str) -> frozenset[str]:
    """Name every form that a network's text uses, whether or not it runs."""
    seen: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call():
                seen.update(_forms_of_call(node))
            case ast.BinOp(op=ast.Pow()):
                seen.add("pow")
            case ast.BinOp(op=ast.MatMult()):
                seen.add("matmul")
    return frozenset(seen)


def _forms_of_call(call: ast.Call) -> Iterator[str]:
    """Name what one call computes; nothing where it calls a part of the network, or what does not belong to torch."""
    if not isinstance(call.func, ast.Attribute):
        return
    owner, name = ast.unparse(call.func.value), call.func.attr
    of_torch = owner.split(".")[0] in ("torch", "nn", "F")
    if owner == "self" or name.startswith("__") or not (of_torch or hasattr(torch.Tensor, name)):
        return
    op = operation(name).replace("_", "")
    if op in _NOTHING or is_factory(op):
        return
    yield op
    if op.startswith("conv"):
        yield from (f"{op} {word.arg}" for word in call.keywords if word.arg in ("dilation", "groups", "stride"))


def forms_of_answers() -> frozenset[str]:
    """Name every form in the recorded answers from which a source can be extracted."""
    seen: frozenset[str] = frozenset()
    for answer in examples("llm_answers"):
        source = extracted(completion(answer["response"], answer["stop_reason"]), contract(answer["task"]))
        seen |= frozenset() if isinstance(source, Rejection) else forms(source)
    return seen
