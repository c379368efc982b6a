"""The runs that come with the project are what their page says, and come again anywhere."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from bundles import members_of
from checkout import BUNDLES, PUBLISHED, ROOT
from commands import tacevo
from scipy import stats
from test_rules import LATER

from tacevo.bundles.open import opened
from tacevo.cli.app import main
from tacevo.results.run import read_run
from tacevo.results.study import load_study
from tacevo.results.study_directory import studies_of

SHIPPED = sorted(PUBLISHED.glob("*.zip"))

#: The pages of what was found.
FOUND = ROOT / "docs/found"

#: What a bundle says of who answered; the others say that the grammar did, and no LLM.
ANSWERED = {
    "claude-vs-grammar": [
        "The hosted API was not called",
        "Answers by the grammar provider: no LLM",
        "no verdict on a model",
    ],
    "grating-claude": ["The hosted API was not called", "one observation"],
    "first-mutations": ["no model was asked", "not compare them"],
    "operator-or-search": ["The hosted API was not called", "one of 25 children of the elites could be trained"],
    "telling-losses": ["The hosted API was not called", "The control can be seen through"],
    "words-temperature": ["The hosted API was not called", "the losses say nothing"],
    "grating-by-hand": ["No model was asked"],
    "grating-variants": ["No model was asked"],
    "grating-winners": ["No model was asked", "The hosted API was not called"],
    "force-variants": ["No model was asked"],
}

#: Two edits by hand, on two tasks, and an elite beside them: how the page gives the losses, and of which networks.
CONTROLS = {
    PUBLISHED / "grating-by-hand.zip": ("by_hand", "of the cross-entropies {:.3f} and {:.3f}", ("by_hand", "baseline")),
    BUNDLES / "grating-by-hand-48.zip": (
        "by_hand",
        "cross-entropies likewise {:.2f} and {:.2f}",
        ("by_hand", "baseline"),
    ),
    BUNDLES / "grating-chosen-48.zip": (
        "ends",
        "of the cross-entropies are {:.3f}, {:.3f} and {:.3f}",
        ("chosen", "baseline", "by_hand"),
    ),
}

named = pytest.mark.parametrize("bundle", SHIPPED, ids=lambda path: path.stem)


def digests() -> dict[str, str]:
    """Read the digest of each file from the page."""
    page = (PUBLISHED / "README.md").read_text()
    return dict(re.findall(r"^\| `([\w.-]+\.zip)` \|.*\| `([0-9a-f]{64})` \|$", page, flags=re.MULTILINE))


def test_page_names_every_file() -> None:
    """What is not on the page is not published; `make replay` replays what is."""
    assert set(digests()) == {path.name for path in SHIPPED}


@named
def test_page_has_the_digest_of_each_file(bundle: Path) -> None:
    """As its own README states it, and a replay prints it."""
    assert f"`{digests()[bundle.name]}`" in members_of(bundle)["README.md"].decode()


def test_page_has_the_bundle_digest_of_each_file() -> None:
    """Nothing else speaks for a figure, a text or a table of an older release: who edits one can seal it again."""
    page = (PUBLISHED / "README.md").read_text()
    said = re.findall(r"^\| `([\w.-]+\.zip)` \| `([0-9a-f]{64})` \|$", page, flags=re.MULTILINE)
    assert dict(said) == {path.name: opened(path).digest for path in SHIPPED}


@named
def test_published_run_says_what_answered(bundle: Path) -> None:
    """Nobody takes the grammar's answers for those of an LLM, nor answers that were handed over for those of an API."""
    members = members_of(bundle)
    words = ANSWERED.get(bundle.stem, ["no LLM"])
    for name in ("README.md", "ro-crate-metadata.json"):
        said = " ".join(members[name].decode().split())
        assert [one for one in words if one not in said] == []


def test_page_says_what_an_elite_chosen_by_a_full_training_is() -> None:
    """Of each search the best of five by the validation loss of one seed, tested by the other, beside the baseline."""
    ratios, points, below = dict[int, list[float]](), dict[int, list[float]](), 0
    for folder in opened(PUBLISHED / "ablation-elites.zip").runs:
        run = read_run(folder)
        (study,) = [record for path in studies_of(folder) if (record := path.read()).terms is not None]
        of = {(row.network, row.seed): row for row in load_study(folder / "studies" / study.name).scores}
        elites = {name for name, _ in of} - {"baseline"}
        for seed in (0, 1):
            chosen = min(elites, key=lambda name: of[name, seed].validation_loss)
            one, other = of[chosen, 1 - seed].metrics, of["baseline", 1 - seed].metrics
            ratios.setdefault(run.config.seed, []).append(math.log(one["cross_entropy"] / other["cross_entropy"]))
            points.setdefault(run.config.seed, []).append(100 * (one["accuracy"] - other["accuracy"]))
        below += sum(ratios[run.config.seed][-2:]) < 0
    said = " ".join((FOUND / "ends.md").read_text(encoding="utf-8").split())
    (low, middle, high), (less, many, more) = map(_interval, (ratios, points))
    assert f"has {math.exp(middle):.2f} [{math.exp(low):.2f}, {math.exp(high):.2f}] of the baseline's loss" in said
    assert f"and {many:.2f} [{less:.2f}, {more:.2f}] points more; it is below in {below} of 16 searches" in said


@pytest.mark.parametrize("bundle", CONTROLS, ids=lambda path: path.stem)
def test_page_says_what_the_control_is(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Accuracies with their intervals as `tacevo show` prints them, and the geometric mean of each network's losses."""
    assert main(["show", str(bundle)]) == 0
    accuracies = re.findall(r"\d+\.\d % \[\d+\.\d, \d+\.\d\]", capsys.readouterr().out)
    page, words, names = CONTROLS[bundle]
    assert len(accuracies) == len(names)
    (folder,) = opened(bundle).runs
    (study,) = studies_of(folder)
    losses = dict[str, list[float]]()
    for row in load_study(study.path).scores:
        losses.setdefault(row.network, []).append(row.metrics["cross_entropy"])
    means = words.format(*(stats.gmean(losses[name]) for name in names))
    said = " ".join((FOUND / f"{page}.md").read_text(encoding="utf-8").split())
    assert [part for part in (*accuracies, means) if part not in said] == []


def _interval(values: dict[int, list[float]]) -> tuple[float, float, float]:
    """Return mean and 95 % t interval of the means by seed, which both arms and both halves of a search share."""
    means = np.array([np.mean(of_seed) for of_seed in values.values()])
    half = stats.t.ppf(0.975, len(means) - 1) * means.std(ddof=1) / math.sqrt(len(means))
    return means.mean() - half, means.mean(), means.mean() + half


@pytest.mark.slow
@named
def test_later_release_replays_what_is_published(bundle: Path) -> None:
    """To the digest of the page, whichever number of the rules is raised."""
    assert tacevo("replay", bundle, before=LATER).stdout.splitlines()[-1] == f"digest: {digests()[bundle.name]}"


@pytest.mark.slow
def test_tables_are_those_of_every_process(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python hashes texts otherwise in each process, so what is written in the order of a set differs between two."""
    written = []
    for seed in ("1", "2", "3"):
        monkeypatch.setenv("PYTHONHASHSEED", seed)
        tacevo("ablations", PUBLISHED / "ablation-elites.zip", "-o", place / seed)
        files = (place / seed).rglob("*")
        written.append({path.name: path.read_bytes() for path in files if path.suffix in {".md", ".csv", ".tex"}})
    assert len(written[0]) > 50
    assert written[0] == written[1] == written[2]


@pytest.mark.slow
def test_published_training_comes_again_bit_for_bit(capsys: pytest.CaptureFixture[str]) -> None:
    """Of the force run, by portable numerics, on this machine."""
    assert main(["replay", str(BUNDLES / "force-grammar.zip"), "--retrain", "1"]) == 0
    assert "weights are bit for bit as recorded" in capsys.readouterr().out
