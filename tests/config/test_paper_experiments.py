"""Promise: the paper's experiments are what is written here, under all later defaults; their model is chosen."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from tacevo.cli.app import main
from tacevo.config.compose import compose, compose_study
from tacevo.config.conf_folder import conf_root
from tacevo.config.identity import identity
from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.records import to_json

#: What a run of `experiment=paper_force llm=anthropic` begins its ledger with (docs/paper.md says whose decisions).
PAPER: dict[str, Any] = {
    "seed": 0,
    "search": {"candidates": 50, "initial": 10},
    "llm": {"provider": "anthropic", "model": "claude-haiku-4-5-20251001", "max_tokens": 4096, "slip_rate": 0.0},
    "archive": {
        "niches": 100,
        "prompt_niches": 100,
        "samples": 20_000,
        "seed": 0,
        "bounds": "adaptive",
        "arch_div_bounds": [0.0, 1.0],
        "eff_ratio_bounds": [0.0, 1000.0],
        "eff_ratio_scale": "linear",
    },
    "temperature": {"rule": "paper", "start": 0.6, "step": 0.05, "jitter": 0.1},
    "prompts": {"policy": "uniform"},
    "proposals": {"mutation_probability": 0.85, "parents": "uniform", "best": 4},
    "training": {"epochs": 10, "batch_size": 32, "learning_rate": 0.001, "seconds": 86_400.0, "memory_mib": 4096},
    "gate": {
        "max_parameters": 50_000_000,
        "max_flops": 12_000_000_000,
        "max_modules": 2_000,
        "max_source_bytes": 100_000,
        "seconds": 60.0,
        "memory_mib": 4096,
    },
    "numerics": "portable",
}

#: What differs where the grammar answers.
GRAMMAR: Any = {"provider": "grammar", "model": "grammar-2", "max_tokens": 4096, "slip_rate": 0.05}

#: Their data; the number of images is the task's.
DATA: dict[str, Any] = {
    "source": "simulated",
    "image_size": 256,
    "seed": 0,
    "sensor_seed": 0,
    "light": "standard",
    "spacings_mm": [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0],
    "split": "random",
    "split_seed": 0,
    "normalisation": "standardise",
}

#: What a study of their runs is.
STUDY: dict[str, Any] = {
    "elites": 4,
    "seeds": 20,
    "epochs": 50,
    "seconds": 86_400.0,
    "memory_mib": 4096,
    "alpha": 0.05,
}

TASKS = pytest.mark.parametrize(("task", "images"), [("force", 3000), ("grating", 3507)])


def written(task: str, images: int, llm: Any) -> list[Any]:
    """Return what is written above, in the order of `chosen`."""
    return [{**PAPER, "llm": llm}, 20, task, {**DATA, "images": images}]


def chosen(config: RunConfig) -> list[Any]:
    """Return what a configuration has of it."""
    plain = to_json(config.data)
    data = {key: plain[key] for key in (*DATA, "images")}
    return [identity(config), config.search.generations, config.task.name, data]


@TASKS
@pytest.mark.parametrize("llm", [PAPER["llm"], GRAMMAR])
def test_paper_experiments_are_what_is_written_here(task: str, images: int, llm: Any) -> None:
    """Every setting that decides a result has the value above; who changes one changes this test, and says why."""
    config = compose([f"experiment=paper_{task}", f"llm={llm['provider']}"])
    assert chosen(config) == written(task, images, llm)


@TASKS
def test_later_defaults_change_no_paper_experiment(task: str, images: int, tmp_path: Path) -> None:
    """Neither another default choice, nor another value in a file that is a default and not the paper's."""
    compose([])  # tells Hydra the defaults
    conf = shutil.copytree(conf_root(), tmp_path / "conf")
    edits = {
        "config.yaml": [
            ("temperature: paper", "temperature: stall"),
            ("prompts: uniform", "prompts: curiosity"),
            ("training: short", "training: quick"),
            ("numerics: portable", "numerics: fast"),
            ("data: simulated", "data: folder"),
            ("seed: 0", "seed: 7"),
            ("initial: 10", "initial: 99"),
            ("candidates: 50", "candidates: 9"),
            ("max_flops: 12_000_000_000", "max_flops: 5"),
        ],
        "archive/cvt.yaml": [
            ("\nniches: 100", "\nniches: 7"),
            ("bounds: adaptive", "bounds: fixed"),
        ],
        "llm/anthropic.yaml": [
            ("model: claude-haiku-4-5-20251001", "model: claude-newest"),
            ("max_tokens: 4096", "max_tokens: 9"),
            ("top_p: null", "top_p: 0.5"),
        ],
    }
    for name, pairs in edits.items():
        text = (conf / name).read_text(encoding="utf-8")
        for was, becomes in pairs:
            assert was in text
            text = text.replace(was, becomes)
        (conf / name).write_text(text, encoding="utf-8")
    GlobalHydra.instance().clear()
    with initialize_config_dir(config_dir=str(conf), version_base="1.3"):
        composed = hydra_compose("config", overrides=[f"experiment=paper_{task}", "llm=anthropic"])
    config = from_plain(OmegaConf.to_container(composed, resolve=True))  # type: ignore[arg-type]
    assert chosen(config) == written(task, images, PAPER["llm"])


GPU = ["training.device=cuda", "training.gpu=NVIDIA H200", "numerics=fast", "sandbox.require=none"]


@pytest.mark.parametrize(
    ("overrides", "precision"),
    [
        (["experiment=paper_force", *GPU], "tf32"),
        (["experiment=paper_grating", *GPU], "tf32"),
        (["experiment=paper_force", *GPU, "training.precision=float32"], "float32"),
        (["experiment=paper_force", *GPU, "training.precision=bf16"], "bf16"),
        (["experiment=demo", *GPU], "float32"),
        (["experiment=paper_force"], "float32"),
    ],
)
def test_paper_experiments_use_tf32_on_a_gpu(
    overrides: list[str], precision: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only there, and where nothing else is said; what is used is shown, recorded and read again as it is."""
    config = compose([*overrides, "llm=grammar"])
    assert config.training.precision == precision
    assert from_plain(to_json(config)) == config
    assert identity(config) == identity(replace(config, executor=replace(config.executor, per_gpu=5)))
    main(["search", *overrides, "llm=grammar", "--cfg", "job"])
    assert f"\n  precision: {precision}\n" in capsys.readouterr().out


def test_study_of_a_paper_experiment_is_what_is_written_here() -> None:
    """Four elites and the baseline, 20 seeds, 50 epochs, and the margins that the verdicts depend on."""
    study = compose_study(["run=runs/a"])
    assert {key: getattr(study, key) for key in STUDY} == STUDY
    margins = [(margin.value, margin.kind) for margin in (study.margins.regression, study.margins.classification)]
    assert margins == [(0.1, "relative"), (0.01, "absolute")]


@pytest.mark.parametrize("options", [[], ["-m", "seed=0,1"], ["ablation=llm_vs_grammar"]])
def test_paper_experiment_without_a_model_says_what_to_add(
    options: list[str], place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, before anything is made."""
    assert main(["search", "experiment=paper_force", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "experiment=paper_force leaves the choice of the model to you; add llm=anthropic (Claude)" in line
    assert list(place.iterdir()) == []


@pytest.mark.room("data check", "simulator")
def test_data_of_a_paper_experiment_are_looked_at_without_a_model(place: Path) -> None:
    """Images do not need a model, so a model need not be chosen."""
    assert main(["data", "check", "experiment=paper_force", "data.images=10", "data.image_size=32"]) == 0


def test_choices_of_the_user_hold_against_the_pins() -> None:
    """A group, a value and a model that are given beside the experiment are not silently the paper's."""
    others = ["temperature=stall", "archive=cvt", "archive.niches=7", "prompts=none", "training=quick", "seed=3"]
    config = compose(["experiment=paper_force", "llm=anthropic", "llm.model=mine", *others])
    assert (config.llm.model, config.temperature.rule, config.archive.niches) == ("mine", "stall", 7)
    assert (config.prompts.policy, config.training.epochs, config.seed) == ("none", 5, 3)
