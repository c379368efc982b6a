"""Promise: every cell of every notebook runs, from top to bottom."""

import json
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from checkout import ROOT

pytestmark = pytest.mark.room("figures")

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.slow  # `make docs` runs them as well
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the directory where it lies, as Jupyter runs it; outputs are not kept, so that none can be outdated."""
    path = notebook
    monkeypatch.chdir(path.parent)
    cells = json.loads(path.read_text())["cells"]
    space: dict[str, object] = {"__name__": "__main__"}
    mpl.use("agg")
    for number, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec(compile("".join(cell["source"]), f"<{path.name}, cell {number}>", "exec"), space)
    plt.close("all")
