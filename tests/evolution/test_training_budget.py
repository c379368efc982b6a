"""Promise: a search's trainings are counted once each, and end it at the bound."""

import pytest
from ledger_lines import rejected, trained

from tacevo.evolution.lines import trained_networks, training_flops
from tacevo.evolution.state import Budget

#: The second network came twice.
TRAINED = [("a", 100), ("b", 30), ("b", 30), ("c", 0)]


def test_each_network_counts_once_for_every_image_of_every_epoch() -> None:
    """By hand: (100 + 30 + 0) x 7 images x 3 epochs."""
    assert training_flops(TRAINED, images=7, epochs=3) == 130 * 21
    assert training_flops([], images=7, epochs=3) == 0


@pytest.mark.parametrize(("flops", "spent"), [(2730, True), (2730.5, False), (1e99, False), (0.5, True)])
def test_budget_is_spent_at_its_bound(flops: float, spent: bool) -> None:
    """Exactly the bound is enough."""
    assert Budget(flops=flops, images=7, epochs=3).is_spent(TRAINED) == spent


def test_ledger_names_its_networks_by_their_sources() -> None:
    """Whatever the keys of their trainings are, which change with the rules; what failed is not among them."""
    lines = [
        trained("g00s00", 0.5, source="a", evaluation="old", flops=100),
        trained("g01s00", 0.4, source="b", flops=30),
        trained("g02s00", 0.5, source="a", evaluation="new", flops=100),
        rejected("g02s01", "train", "not_finite"),
    ]
    assert training_flops(trained_networks(lines), images=7, epochs=3) == 130 * 21
