"""Changes to a source text at the places of its syntax tree, which count bytes."""

import ast
import re
from collections.abc import Iterable

#: A change: where it begins and ends, as bytes of the text, and the text that stands there then.
Edit = tuple[int, int, str]


class Lines:
    """A text by the bytes of its lines, as the places of a syntax tree count them."""

    def __init__(self, text: str) -> None:
        self.data = text.encode()
        self._starts = [0]
        for line in text.split("\n"):
            self._starts.append(self._starts[-1] + len(line.encode()) + 1)

    def span(self, node: ast.stmt | ast.expr) -> tuple[int, int]:
        """Return the bytes at which a node begins and ends."""
        last = self._starts[(node.end_lineno or node.lineno) - 1]
        return self._starts[node.lineno - 1] + node.col_offset, last + (node.end_col_offset or 0)

    def whole_lines(self, node: ast.stmt | ast.expr) -> tuple[int, int]:
        """Return the bytes at which the lines of a node begin and end."""
        return self._starts[node.lineno - 1], self._starts[node.end_lineno or node.lineno]

    def source(self, node: ast.stmt | ast.expr) -> str:
        """Return what is written for a node."""
        first, last = self.span(node)
        return self.data[first:last].decode()

    def instead(self, node: ast.stmt, written: str) -> Edit:
        """Write something else in the place of a statement; nothing takes its lines where nothing else holds them."""
        first, last = self.span(node)
        start, end = self.whole_lines(node)
        if not written and node.col_offset == 0 and re.fullmatch(rb"\s*(?:#.*)?\s*", self.data[last:end]):
            return start, end, ""
        return first, last, written or "pass"

    def edited(self, edits: Iterable[Edit]) -> str:
        """Return the text after edits that do not overlap."""
        parts: list[bytes] = []
        done = 0
        for start, end, written in sorted(edits):
            parts += [self.data[done:start], written.encode()]
            done = end
        return b"".join([*parts, self.data[done:]]).decode()
