"""Promise: nine significant digits are kept, whatever the size."""

import pytest

from tacevo.rounding import rounded


@pytest.mark.parametrize(
    ("value", "kept"),
    [(2 / 3, 0.666666667), (2e-12 / 3, 6.66666667e-13), (123456789.6, 123456790.0), (0.1 + 0.2, 0.3), (-0.0, 0.0)],
)
def test_nine_significant_digits_are_kept(value: float, kept: float) -> None:
    """Of small and of large numbers; the dust of binary sums is gone."""
    assert rounded(value) == kept
