"""The parts of this package keep the contracts of their kinds, and do what they are for."""

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from tacevo_lexicase.outputs import Ancestors
from tacevo_lexicase.parents import Ageing, Lexicase, novelty
from tacevo_lexicase.sources import RobotLogs

from tacevo.errors import DataError
from tacevo.parts.testing import Contract, check, contracts
from tacevo.sandbox.part import SeenCandidate


def logs(folder: Path, touches: int = 12) -> Path:
    """Write the logs of some touches, of 5 images each, as a robot would."""
    rng = np.random.default_rng(0)
    for touch in range(touches):
        depth = np.linspace(0, 1, 5)
        images = np.clip(40 + 150 * depth[:, None, None, None] + rng.normal(0, 5, (5, 24, 32, 3)), 0, 255)
        wrench = np.outer(depth, [0.1, 0.2, -3.0 - touch, 0, 0, 0])
        np.savez(
            folder / f"touch{touch:02d}.npz",
            images=images.astype(np.uint8),
            wrench=wrench,
            timestamps=np.arange(5) / 30,
        )
    return folder


@pytest.mark.parametrize(
    "contract",
    [
        *contracts(Lexicase()),
        *contracts(Lexicase(cases="fitness")),
        *contracts(Ageing()),
        *contracts(Ageing(population=2, sample=1)),
        *contracts(Ancestors()),
    ],
    ids=str,
)
def test_contract_is_kept(contract: Contract) -> None:
    """The two rules with several settings, and the table."""
    contract.check()


@pytest.mark.parametrize("place", ["lexicase.zip", "lexicase.zip/proposals.parents-lexicase-seed0"])
def test_ancestors_are_shown_of_runs_and_sweeps(place: str) -> None:
    """Of the ablation that is published, and of one of its jobs: table, figure and section."""
    check(Ancestors(), run=Path(__file__).parents[2] / place)


def test_logs_keep_their_contracts(tmp_path: Path) -> None:
    """Of whole logs, and of every second image."""
    for source in (RobotLogs(root=logs(tmp_path), image_size=32), RobotLogs(root=tmp_path, image_size=32, every=2)):
        for contract in contracts(source):
            contract.check()


def candidate(name: str, source: str, **numbers: float) -> SeenCandidate:
    """Return a candidate of these numbers; 1 where none is given."""
    given = {"fitness": 1.0, "flops": 1, "parameters": 1, **numbers}
    return SeenCandidate(id=name, source=source, losses=(1.0,), parents=(), curiosity=1.0, **given)  # type: ignore


def test_lexicase_takes_whoever_is_best_at_something() -> None:
    """Never the one that is worse at everything; over many draws each of the others."""
    pool = [
        candidate("fit", "a b c", fitness=0.1, flops=90, parameters=90),
        candidate("small", "a b c", fitness=0.9, flops=10, parameters=10),
        candidate("new", "x y z", fitness=0.9, flops=90, parameters=90),
        *(candidate(f"worse{number}", "a b c", fitness=0.9, flops=90, parameters=90) for number in range(3)),
    ]
    drawn = [Lexicase().draw(pool, 1, np.random.default_rng(seed))[0].id for seed in range(200)]
    assert set(drawn) == {"fit", "small", "new"}


def test_ageing_forgets_the_old() -> None:
    """The fittest of all is no parent once it is too old."""
    pool = [candidate(f"g00s{number:02d}", "", fitness=float(number)) for number in range(30)]
    from tacevo.parts import Population

    living = Ageing(population=10).pool(Population(generation=1, candidates={one.id: one for one in pool}, elites=pool))
    assert [one.id for one in living] == [one.id for one in pool[-10:]]
    assert Ageing(sample=10).draw(living, 1, np.random.default_rng(0))[0].id == "g00s20"


def test_novelty_counts_other_words() -> None:
    """A copy is not new; a source without a word of the others is."""
    pool = [candidate("one", "a b"), candidate("two", "a b"), candidate("three", "c d")]
    assert novelty(pool[0], pool, nearest=1) == 0
    assert novelty(pool[2], pool) == 1


def test_log_that_is_broken_is_named(tmp_path: Path) -> None:
    """With its file."""
    np.savez(logs(tmp_path) / "touch99.npz", images=np.zeros((2, 8, 8)), wrench=np.zeros((2, 6)), timestamps=[0, 1])
    with pytest.raises(DataError, match="touch99"):
        RobotLogs(root=tmp_path, image_size=32).catalogue()


def test_package_offers_its_parts() -> None:
    """By the names that its README has."""
    for group, names in {
        "parents": {"lexicase", "ageing"},
        "sources": {"robot_logs"},
        "outputs": {"ancestors"},
    }.items():
        assert names <= {point.name for point in entry_points(group=f"tacevo.{group}")}
