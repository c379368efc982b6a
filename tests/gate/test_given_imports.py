"""Promise: what a source leaves to the sandbox is imported, and nothing else of it changes."""

import pytest

from tacevo.gate.imports import with_imports

#: Python's tokenizer sees no end of a line in these; `str.splitlines` does.
NO_ENDS = ["\f", "\v", "\x1c", "\x1d", "\x1e", "\x85", "\u2028", "\u2029"]


@pytest.mark.parametrize("letter", NO_ENDS, ids=ascii)
def test_imports_stand_between_docstring_and_code(letter: str) -> None:
    """Whatever letters the docstring has."""
    docstring, code = f'"""A network.\n{letter}{letter}It is small."""', "class Net(nn.Module):\n    pass\n"
    assert with_imports(f"{docstring}\n{code}") == f"{docstring}\n\nimport torch.nn as nn\n{code}"
