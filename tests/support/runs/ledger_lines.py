"""Lines of ledgers and a run.json without a search; a test names only what it is about."""

from typing import Any

from fakes import TASK

from tacevo.choices import Device, MarginKind, Numerics
from tacevo.config.study import Margin
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import RunLine
from tacevo.records import DataFacts, Kind, Limits, Operator, Reason, Recipe, Stage
from tacevo.results.study_lines import ScoreLine, StudyHeader, StudyNetwork, StudyTerms
from tacevo.storage.run_directory import RunRecord

FACTS = DataFacts(
    fingerprint="f" * 64,
    kind=Kind.regression,
    counts=(384, 48, 48),
    in_channels=3,
    image_size=32,
    outputs=3,
    names=("Fx", "Fy", "Fz"),
)

RECIPE = Recipe(
    epochs=50, batch_size=32, learning_rate=0.001, optimiser="adam", limits=Limits(seconds=600.0, memory_mib=2048)
)

#: Of conf/study.yaml.
TERMS = {
    Kind.regression: StudyTerms(alpha=0.05, margin=Margin(value=0.1, kind=MarginKind.relative)),
    Kind.classification: StudyTerms(alpha=0.05, margin=Margin(value=0.01, kind=MarginKind.absolute)),
}


def header(**changes: Any) -> RunLine:
    """Make the first line of a ledger."""
    values = {"schema": 1, "config": {"seed": 0}, "task": "t", "data": FACTS, "centroids": "c"}
    return RunLine(**{**values, **changes})


def candidate(name: str, **changes: Any) -> CandidateLine:
    """Make the line of a candidate, a mutation, of which nothing came yet; the baseline is `g00s00`."""
    values = {
        "id": name,
        "generation": int(name[1:3]),
        "slot": int(name[4:]),
        "operator": Operator.baseline if name == "g00s00" else Operator.mutation,
        "parents": () if name == "g00s00" else ("g00s00",),
        "prompt": None if name == "g00s00" else 1,
        "request": None if name == "g00s00" else "r",
        "temperature": None if name == "g00s00" else 0.6,
        "answer": None if name == "g00s00" else "a",
    }
    return CandidateLine(**{**values, **changes})


def trained(name: str, fitness: float, **changes: Any) -> CandidateLine:
    """Make the line of a candidate that trained; its source follows from its slot."""
    values = {
        "source": f"source {name[4:]}",
        "evaluation": f"evaluation {name[4:]}",
        "parameters": 1_234_567,
        "flops": 9_876_543,
        "entropy": 0.7,
        "variation": 0.5,
        "density": 0.3,
        "arch_div": 0.51234,
        "eff_ratio": 12.3456,
        "fitness": fitness,
        "train_losses": (0.75, fitness),
        "validation_losses": (0.5, fitness),
        "predictions": "p",
        "weights": "w",
        "niche": 4,
        "status": AddStatus.new,
        "curiosity": 1.8,
    }
    return candidate(name, **{**values, **changes})


def rejected(name: str, stage: str, reason: str, **changes: Any) -> CandidateLine:
    """Make the line of a rejected candidate."""
    return candidate(name, stage=Stage(stage), reason=Reason(reason), **changes)


def ended(number: int, **changes: Any) -> GenerationLine:
    """Make the line of a generation."""
    values = {
        "generation": number,
        "temperature": 0.6,
        "next_temperature": 0.65,
        "candidates": 3,
        "trained": 2,
        "best": 0.25,
        "generation_best": 0.25,
        "generation_median": 0.25,
        "coverage": 0.02,
        "qd_score": 1.75,
        "prompt_coverage": 0.01,
        "bounds": None,
        "archive": "n",
        "prompt_archive": "p",
    }
    return GenerationLine(**{**values, **changes})


def run_record(**changes: Any) -> RunRecord:
    """Make what run.json holds of a run that is not finished."""
    values = {
        "name": "run",
        "config": {},
        "task": TASK,
        "data": FACTS,
        "versions": {},
        "machine": {},
        "confinement": (),
        "digest": None,
    }
    return RunRecord(**{**values, **changes})


def study_header(**changes: Any) -> StudyHeader:
    """Make the first line of the scores of two networks under two seeds."""
    values = {
        "schema": 2,
        "run": "r",
        "task": "force",
        "seed": 0,
        "data": FACTS,
        "recipe": RECIPE,
        "numerics": Numerics.portable,
        "device": Device.cpu,
        "seeds": 2,
        "terms": TERMS[Kind.regression],
        "networks": tuple(
            StudyNetwork(name=name, id="g00s00", source="s", fitness=0.1, parameters=1, flops=2)
            for name in ("baseline", "variant 1")
        ),
    }
    return StudyHeader(**{**values, **changes})


def score(network: str, seed: int, mse: float) -> ScoreLine:
    """Make the score of a network under a seed."""
    return ScoreLine(
        network=network,
        id="g00s00",
        seed=seed,
        evaluation="e",
        epoch=1,
        validation_loss=0.5,
        metrics={"mse": mse},
        confusion=None,
        predictions="p",
        weights="w",
    )
