"""Promise: a picture of a page that has a script is what the script draws."""

import subprocess
import sys
from pathlib import Path

import pytest
from checkout import ROOT


@pytest.mark.parametrize("name", ["loop", "difficulty"])
def test_picture_is_what_its_script_draws(name: str, tmp_path: Path) -> None:
    """Drawn again, it has the same bytes."""
    drawn = tmp_path / f"{name}.svg"
    subprocess.run([sys.executable, f"docs/site/{name}.py", drawn], cwd=ROOT, check=True)
    assert drawn.read_bytes() == (ROOT / "docs/figures" / drawn.name).read_bytes()
