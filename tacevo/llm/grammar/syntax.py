"""Source text to a plain syntax tree, in which equal networks written in slightly different ways look alike."""

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast


class UnreadableError(ValueError):
    """The source is no network of the grammar; the message is a sentence that says what could not be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A call of a layer; every part is source text."""

    name: str
    arguments: tuple[str, ...]
    keywords: dict[str, str]


def plain_tree(source: str) -> ast.Module:
    """Parse source text and take away what does not change the network.

    Gone are imports, docstrings and annotations; constant arithmetic is worked out, and a few layers that can be
    written in several ways are written in one.

    Raises:
        UnreadableError: the text is not Python, or is nested too deeply to be walked.
    """
    try:
        return cast(ast.Module, _Plain().visit(ast.parse(source)))
    except (SyntaxError, ValueError) as error:  # ValueError: a null byte
        raise UnreadableError(f"the source is not valid Python: {error}") from error
    except RecursionError as error:
        raise UnreadableError("the source is nested too deeply") from error


def read_call(node: ast.AST) -> Call:
    """Take a call apart.

    Raises:
        UnreadableError: `node` is something else than a call.
    """
    if not isinstance(node, ast.Call):
        raise UnreadableError(f"`{ast.unparse(node)}` stands where a layer was expected")
    return Call(
        name=ast.unparse(node.func),
        arguments=tuple(ast.unparse(argument) for argument in node.args),
        keywords={keyword.arg or "**": ast.unparse(keyword.value) for keyword in node.keywords},
    )


class _Plain(ast.NodeTransformer):
    """Rewrites a tree into its plain form, from the leaves up."""

    def visit_Module(self, node: ast.Module) -> ast.Module:
        self.generic_visit(node)
        kept = [statement for statement in node.body if not isinstance(statement, ast.Import | ast.ImportFrom)]
        node.body = _without_docstring(kept)
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        self.generic_visit(node)
        node.body = _without_docstring(node.body)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.generic_visit(node)
        node.body = _without_docstring(node.body)
        node.returns = None
        for argument in node.args.args:
            argument.annotation = None
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        self.generic_visit(node)
        return ast.Name("nn", ctx=ast.Load()) if ast.unparse(node) == "torch.nn" else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        left, right = node.left, node.right
        if (
            isinstance(node.op, ast.Mult)
            and isinstance(left, ast.Constant)
            and isinstance(right, ast.Constant)
            and isinstance(left.value, int)
            and isinstance(right.value, int)
        ):
            return ast.Constant(left.value * right.value)
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        name = ast.unparse(node.func)
        if name == "super":
            node.args = []
        if name == "nn.Conv2d" and len(node.args) > 2:
            names = ("kernel_size", "stride", "padding")
            node.keywords += [
                ast.keyword(arg=arg, value=value) for arg, value in zip(names, node.args[2:], strict=False)
            ]
            node.args = node.args[:2]
        node.keywords = [keyword for keyword in node.keywords if keyword.arg != "inplace"]
        if len(node.keywords) == 1 and not node.args and node.keywords[0].arg in {"p", "kernel_size", "output_size"}:
            node.args, node.keywords = [node.keywords[0].value], []
        if name.startswith("nn.Adaptive") and len(node.args) == 1 and isinstance(node.args[0], ast.Constant):
            node.args = [ast.Tuple([node.args[0], node.args[0]], ctx=ast.Load())]
        node.keywords.sort(key=lambda keyword: keyword.arg or "")
        return node


def _without_docstring(body: Sequence[ast.stmt]) -> list[ast.stmt]:
    """Drop statements that are only a string."""
    return [
        statement
        for statement in body
        if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant))
    ]
