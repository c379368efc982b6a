"""Errors carry fields; their text is made of them."""

import pickle

import pytest

from tacevo.errors import ConfigError, RunError, TacevoError


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (
            ConfigError("0", place="training.epochs", expected="an integer of at least 1", remedy="set another"),
            "training.epochs: expected an integer of at least 1; got 0; set another",
        ),
        (RunError("no space left", place="run.json"), "run.json: no space left"),
        (RunError("no space left"), "no space left"),
    ],
)
def test_text_names_place_expectation_finding_and_remedy(error: TacevoError, text: str) -> None:
    """In this order; what is not given leaves no trace."""
    assert str(error) == text


def test_fields_survive_a_worker() -> None:
    """A process pool pickles what its workers raise."""
    error = ConfigError("0", place="seed", expected="1", remedy="set 1")
    assert vars(pickle.loads(pickle.dumps(error))) == vars(error)
