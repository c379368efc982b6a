"""Promise: `choose=validated` hands over the elite of the lowest validation loss; the seed that chose never tests."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import members_of
from commands import publish
from refusals import refused
from rewritten import write_study
from run_files import contents, copy_that_stands_here
from smallest import Once

import tacevo
from analysis.tables.choice import choice_table
from tacevo.choices import ChosenBy
from tacevo.cli.app import main
from tacevo.config.compose import compose_study
from tacevo.errors import ConfigError, DivergenceError, RunError
from tacevo.records import Reason, Rejection, Stage, to_json
from tacevo.results.run import read_run
from tacevo.results.study import load_study
from tacevo.results.study_directory import StudyDirectory, studies_of, study_names
from tacevo.results.study_lines import ScoreLine
from tacevo.results.sweep import load_sweep
from tacevo.runs.progress import Progress
from tacevo.storage.store import Store
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.studies.networks import networks_of
from tacevo.studies.study import replay_studies, study

pytestmark = pytest.mark.timeout(300)

SETTINGS = ["elites=2", "seeds=2", "epochs=2", "choose=validated"]
CHOSEN = ["study", "run", *SETTINGS]


@pytest.fixture(scope="session")
def chosen(published: Path, once: Once) -> Path:
    """Return a directory with a run, and the study of the elite that a choice handed over; no test may change it."""

    def fill(folder: Path) -> None:
        copy_that_stands_here(published, folder)
        shutil.rmtree(folder / "run" / "studies")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            assert main(CHOSEN) == 0

    return once("chosen", fill)


@pytest.fixture
def folder(chosen: Path, place: Path) -> Path:
    """Work in a copy of them."""
    return Path(shutil.copytree(chosen, place, dirs_exist_ok=True))


def both(folder: Path) -> tuple[StudyDirectory, StudyDirectory]:
    """Return the choice and the study of the elite that it handed over."""
    choice, tested = sorted(studies_of(folder / "run"), key=lambda one: one.read().terms is not None)
    return choice, tested


def scores_of(directory: StudyDirectory) -> list[ScoreLine]:
    """Return the scores of a study."""
    return [row for row in directory.read_scores().rows if isinstance(row, ScoreLine)]


def files(folder: Path) -> dict[str, bytes]:
    """Read the files of all studies."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("**/studies/*-*/*")}


def test_elite_of_the_lowest_validation_loss_is_handed_over(chosen: Path) -> None:
    """Of the fittest elites, each trained once for the study's epochs; it is tested beside the baseline alone."""
    run, (choice, tested) = read_run(chosen / "run"), both(chosen)
    losses = {row.id: row.validation_loss for row in scores_of(choice)}
    elites = [line.id for line in run.best(2)]
    assert list(losses) == [run.baseline.id, *elites]
    assert [one.id for one in tested.read().networks] == [run.baseline.id, min(elites, key=losses.__getitem__)]
    assert elites.index(tested.read().networks[1].id) == 1  # else the fittest might have been taken
    assert choice.read().recipe == tested.read().recipe
    assert (choice.read().seeds, tested.read().seeds) == (1, 2)
    assert all(row.metrics == {} and row.kept is None for row in scores_of(choice))


def test_loss_that_chooses_is_the_lowest_of_the_training(chosen: Path) -> None:
    """Of all epochs, as the study tests the weights of that epoch, whatever the search's own rule is."""
    asked: dict[str, Any] = {entry.key: entry.answer for entry in Store(chosen / "cache", "evaluations").entries()}
    for row in scores_of(both(chosen)[0]):
        losses = asked[row.evaluation]["training"]["validation_losses"]
        assert len(losses) == 2
        assert (row.validation_loss, row.epoch) == (min(losses), losses.index(min(losses)) + 1)


def test_seed_that_chose_neither_tests_nor_searched(chosen: Path) -> None:
    """Every training of the run and its studies has a seed of its own kind."""
    kinds: dict[str, set[int]] = {}
    choice = {row.evaluation for row in scores_of(both(chosen)[0])}
    for kind in ("evaluations", "studies"):
        for entry in Store(chosen / "cache", kind).entries():
            request: Any = entry.request
            name = "choice" if entry.key in choice else kind
            kinds.setdefault(name, set()).add(request["seed"])
    assert len(kinds["choice"]) == 1
    assert not kinds["choice"] & (kinds["studies"] | kinds["evaluations"])


def test_same_command_again_trains_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither for the choice nor for the study; not a byte changes, and the command tells both."""
    before = contents(folder)
    assert main(CHOSEN) == 0
    told = capsys.readouterr().out
    assert "(3 trainings, 3 of them recorded already)" in told
    assert "(4 trainings, 4 of them recorded already)" in told
    assert contents(folder) == before


class StoppedAt(Progress):
    """A user who stops a command when it says something."""

    def __init__(self, start: str) -> None:
        super().__init__()
        self._start = start

    def say(self, text: str) -> None:
        """Stop at the words."""
        if text.startswith(self._start):
            raise KeyboardInterrupt


@pytest.mark.parametrize("start", ["choice: ", "study: "])
def test_stopped_choice_goes_on_to_the_same_bytes(start: str, folder: Path) -> None:
    """Before the choice is made, and between the choice and its study."""
    before = files(folder)
    shutil.rmtree(folder / "run" / "studies")
    with pytest.raises(KeyboardInterrupt):
        study(compose_study(["run=run", *SETTINGS]), StoppedAt(start))
    assert main(["replay", "run"]) == 0  # with what is finished of it
    assert main(CHOSEN) == 0
    assert files(folder) == before


@pytest.mark.slow
def test_two_processes_divide_a_choice_and_its_study(folder: Path) -> None:
    """At the same time, on the same run and store; they give the bytes of one."""
    before = files(folder)
    shutil.rmtree(folder / "run" / "studies")
    shutil.rmtree(folder / "cache" / "studies")
    for row in scores_of(both_at(before, folder)):
        (folder / "cache" / "evaluations" / row.evaluation[:2] / f"{row.evaluation}.json").unlink()
    command = [sys.executable, "-m", "tacevo.cli.app", *CHOSEN, "executor.workers=1"]
    processes = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(2)]
    for process in processes:
        _, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
    assert files(folder) == before


def both_at(known: dict[str, bytes], folder: Path) -> StudyDirectory:
    """Return the choice among files that were read, written beside the run."""
    for name, data in known.items():
        path = folder / "kept" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return both(folder / "kept")[0]


def forge_study(folder: Path) -> None:
    """Let the study be one of the other elite, tested with the same seeds."""
    assert main(["study", "run", "elites=2", "seeds=2", "epochs=2"]) == 0
    of_all = next(one for one in studies_of(folder / "run") if len(one.read().networks) == 3 and one.read().terms)
    tested = both_of(folder)
    other = next(one for one in of_all.read().networks[1:] if one.id != tested.read().networks[1].id)
    header = tested.read_scores().header
    networks = (header.networks[0], replace(other, name="variant 1"))
    rows = [replace(row, network=one.name) for one in networks for row in scores_of(of_all) if row.id == one.id]
    forged(tested, folder, rows, networks=networks)


def both_of(folder: Path) -> StudyDirectory:
    """Return the study of the elite that was handed over."""
    return next(one for one in studies_of(folder / "run") if one.read().choose is ChosenBy.validated)


def forged(directory: StudyDirectory, folder: Path, rows: list[Any], **changes: Any) -> StudyDirectory:
    """Seal other scores and another design of a study, under the name that follows from these."""
    header = replace(directory.read_scores().header, **changes)
    moved = StudyDirectory(directory.path.with_name(study_names(header, searched=True)[0]))
    directory.path.rename(moved.path)
    write_study(moved, header, rows, **changes, name=moved.path.name)
    return moved


def forge_choice(folder: Path) -> None:
    """Let the choice have been among the handed-over elite and nothing else."""
    choice, tested = both(folder)
    kept = (choice.read().networks[0], replace(choice.read().networks[2], name="variant 1"))
    names = {one.id: one.name for one in kept}
    rows = [replace(row, network=names[row.id]) for row in scores_of(choice) if row.id in names]
    moved = forged(choice, folder, rows, networks=kept)
    forged(tested, folder, scores_of(tested), chosen_by=moved.read().digest)


def forge_loss(folder: Path) -> None:
    """Let the other elite have the lowest loss."""
    choice, tested = both(folder)
    rows = [replace(row, validation_loss=0.0) if row.network == "variant 1" else row for row in scores_of(choice)]
    moved = forged(choice, folder, rows)
    forged(tested, folder, scores_of(tested), chosen_by=moved.read().digest)


def forge_number(folder: Path) -> None:
    """Let it have been chosen among more elites than there were trainings."""
    _, tested = both(folder)
    forged(tested, folder, scores_of(tested), validated=5)


def forge_seeds(folder: Path) -> None:
    """Let it have been chosen by the very trainings that test it."""
    _, tested = both(folder)
    forged(tested, folder, scores_of(tested), chosen_by=tested.read().digest)


def forge_epochs(folder: Path) -> None:
    """Let it have been chosen by trainings of fewer epochs than its own."""
    assert main([*CHOSEN[:-2], "epochs=1", CHOSEN[-1]]) == 0
    short = next(one for one in studies_of(folder / "run") if one.read().is_choice and one.read().recipe.epochs == 1)
    tested = next(one for one in studies_of(folder / "run") if one.read().terms and one.read().recipe.epochs == 2)
    forged(tested, folder, scores_of(tested), chosen_by=short.read().digest)


@pytest.mark.parametrize(
    ("forge", "error", "told"),
    [
        (forge_study, DivergenceError, "other values of networks"),
        (forge_choice, DivergenceError, "other values of networks"),
        (forge_loss, DivergenceError, "validation_loss"),
        (forge_number, RunError, "validated"),
        (forge_seeds, RunError, "that the elites of a study were chosen by"),
        (forge_epochs, RunError, "recipe"),
    ],
)
def test_forged_choice_is_found(forge: Callable[[Path], None], error: type[Exception], told: str, folder: Path) -> None:
    """However well it is sealed: a replay chooses again, by the recorded trainings."""
    assert set(replay_studies(read_run(folder / "run"), Progress())) == {one.path.name for one in both(folder)}
    forge(folder)
    with pytest.raises(error, match=told):
        replay_studies(read_run(folder / "run"), Progress())


def test_study_that_tests_chooses_nothing(folder: Path) -> None:
    """Its seeds would choose and test; so a study that names another tested study is refused, by that field."""
    assert main(["study", "run", "elites=1", "seeds=2", "epochs=2"]) == 0
    by_hand = next(
        one for one in studies_of(folder / "run") if one.read().choose is ChosenBy.fitness and one.read().terms
    )
    tested = both_of(folder)
    for changes in ({}, {"validated": 0}):
        tested = forged(tested, folder, scores_of(tested), chosen_by=by_hand.read().digest, **changes)
        with refused(RunError, place="study.json, terms", expected="None"):
            replay_studies(read_run(folder / "run"), Progress())


def reject(folder: Path, choice: StudyDirectory, ids: set[str]) -> None:
    """Let the store say that the trainings that chose came to no end, of these networks."""
    store = Store(folder / "cache", "evaluations")
    keys = {row.evaluation for row in scores_of(choice) if row.id in ids}
    for entry in [one for one in store.entries() if one.key in keys]:
        (folder / "cache" / "evaluations" / entry.key[:2] / f"{entry.key}.json").unlink()
        rejection = Rejection(stage=Stage.train, reason=Reason.not_finite, detail="nan")
        store.write(entry.request, {"rejection": to_json(rejection)})
    shutil.rmtree(folder / "run" / "studies")


def test_elite_that_fails_its_training_is_not_handed_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The best of the others is; the failure is told, and the study has its verdicts all the same."""
    choice, tested = both(folder)
    baseline, first, second = choice.read().networks
    assert tested.read().networks[1].id == second.id
    reject(folder, choice, {second.id})
    assert main(CHOSEN) == 0
    assert f"{second.name}, seed 0: not_finite" in capsys.readouterr().err
    choice, tested = both(folder)
    assert [one.id for one in tested.read().networks] == [baseline.id, first.id]
    assert any(f"{second.name} (not_finite)" in note for note in choice_table(choice.read_finished()).notes)
    assert main(["replay", "run"]) == 0


def test_without_any_elite_that_trains_the_baseline_is_studied_alone(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where an archive holds none; the command says why."""
    choice, _ = both(folder)
    baseline, *elites = choice.read().networks
    reject(folder, choice, {one.id for one in elites})
    assert main(CHOSEN) == 0
    assert "so the baseline is studied alone" in capsys.readouterr().err
    assert [one.id for one in both_of(folder).read().networks] == [baseline.id]
    assert main(["replay", "run"]) == 0
    assert main(["show", "run"]) == 0


def test_earlier_elite_wins_a_tie(chosen: Path) -> None:
    """Equal losses are decided as equal fitnesses are, by the order of the search."""
    run = read_run(chosen / "run")
    first, second = sorted(line.id for line in run.best(2))
    for losses in ({first: 0.5, second: 0.5}, {second: 0.5, first: 0.5}):
        _, handed = networks_of(run.candidates, [second, first], 1, losses)
        assert handed.id == first


def test_tables_and_show_say_what_chose_and_what_it_cost(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each elite's loss, the one that was handed over, and how many trainings that took; the study names the choice."""
    choice, tested = both(folder)
    losses = {row.id: row.validation_loss for row in scores_of(choice)}
    table = choice_table(choice.read_finished())
    assert [(row[1], row[3], row[5]) for row in table.rows] == [
        (name, loss, "handed over" if name == tested.read().networks[1].id else None) for name, loss in losses.items()
    ]
    assert any("3 trainings" in note for note in table.notes)
    capsys.readouterr()
    assert main(["show", "run"]) == 0
    shown = capsys.readouterr().out
    assert f"## {choice.path.name}" in shown
    assert str(choice.read().digest)[:12] in shown
    assert main(["tables", "run", "-o", "out"]) == 0
    assert (folder / "out" / "more" / choice.path.name / "choice.md").exists()
    assert str(choice.read().digest)[:12] in (folder / "out" / "more" / tested.path.name / "scores.md").read_text()


def test_choice_is_no_study_and_no_noise_run(folder: Path) -> None:
    """It has no test scores, and its losses, of more epochs, are no fitnesses of the search."""
    choice, _ = both(folder)
    with refused(RunError, got="a choice", expected="test scores"):
        load_study(choice.path)
    run = tacevo.open("run", store="cache")
    assert isinstance(run, tacevo.Run)
    one = next(each for each in run.studies if each.is_choice)
    assert (one.is_noise, one.name) == (False, choice.path.name)
    assert one.reestimates.empty
    assert one.verdicts.attrs["left_out"]
    assert list(one.scores["validation_loss"]) == [row.validation_loss for row in scores_of(choice)]
    again = tacevo.study("run", choose="validated", elites=2, seeds=2, epochs=2, quiet=True)
    assert again.digest == both_of(folder).read().digest


@pytest.mark.room("noise")
def test_choice_does_not_stand_for_a_noise_run(folder: Path) -> None:
    """`choose=reestimated` takes the losses of the search's own epochs only."""
    with refused(RunError, got="a run without a finished noise run"):
        study(compose_study(["run=run", "elites=1", "seeds=2", "epochs=2", "choose=reestimated"]), Progress())


def test_choice_is_made_on_the_runs_data_and_serves_studies_on_others(folder: Path) -> None:
    """So one network is handed over, whatever it is then tested on."""
    assert main([*CHOSEN, "data.split_seed=7"]) == 0
    choices = [one for one in studies_of(folder / "run") if one.read().is_choice]
    studied = [one.read() for one in studies_of(folder / "run") if one.read().choose is ChosenBy.validated]
    assert len(choices) == 1
    assert len(studied) == 2
    assert len({one.networks for one in studied}) == len({one.chosen_by for one in studied}) == 1
    assert main(["replay", "run"]) == 0


@pytest.mark.parametrize("settings", [["data=numpy", "data.root=gone.npz"], ["plan=gone.json"]])
def test_study_that_is_refused_chooses_nothing(settings: list[str], folder: Path) -> None:
    """Whatever is wrong with the study is told before the trainings that choose for it."""
    before = contents(folder)
    assert main([*CHOSEN, "seeds=3", "epochs=3", *settings]) == 2
    assert contents(folder) == before


@pytest.mark.parametrize("settings", [["run=r", "elites=1"], ["sweep=s"]])
def test_choice_takes_two_elites_at_least(settings: list[str]) -> None:
    """Among one there is nothing to choose; of a sweep's jobs that is the default."""
    with refused(ConfigError, place="elites", expected="at least 2"):
        compose_study([*settings, "choose=validated"])


@pytest.mark.slow
def test_bundle_holds_the_choice_and_can_be_verified(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With its table, and every entry that it needs."""
    publish("run", "-o", "run.zip", "--author", "A. Nyone")
    choice, _ = both(folder)
    assert any(name.endswith(f"{choice.path.name}/choice.md") for name in members_of(folder / "run.zip"))
    assert main(["replay", "run.zip"]) == 0
    assert "EQUAL: search, 2 studies, " in capsys.readouterr().out.splitlines()[-2]


@pytest.mark.slow
@pytest.mark.room("plans, pilots")
def test_sweep_tests_one_handed_over_network_a_job(
    swept: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As stated before the first training; arms are compared by it, and a bundle replays and gives the same tables."""
    for name in ("sweep", "cache"):
        shutil.copytree(swept / name, place / name)
    command = ["study", "sweep=sweep", "elites=3", "seeds=2", "epochs=1", "choose=validated", "store.root=cache"]
    assert main(command) == 0
    before = files(place)
    assert main(command) == 0  # it continues
    assert files(place) == before
    stated = SweepDirectory(Path("sweep")).read().terms.retraining
    assert stated is not None
    assert (stated.elites, stated.tested, stated.choose) == (3, 1, ChosenBy.validated)
    for one in load_sweep(Path("sweep")).finished:
        assert one.tested is not None
        choice, tested = sorted(
            studies_of(place / "sweep" / one.job.name), key=lambda each: each.read().terms is not None
        )
        losses = {row.id: row.validation_loss for row in scores_of(choice)}
        assert one.tested.networks == (min(losses, key=lambda name: (losses[name], name)),)
        assert one.tested.values[0] == tuple(
            row.metrics["mse"] for row in scores_of(tested) if row.id == one.tested.networks[0]
        )
    for settings in ("elites=2", "choose=fitness"):
        assert main([*command, settings]) == 2
    publish("sweep", "--store", "cache", "-o", "sweep.zip", "--author", "A. Nyone")
    assert main(["replay", "sweep.zip"]) == 0
    for source, target in (("sweep", "from-directory"), ("sweep.zip", "from-bundle")):
        assert main(["ablations", source, "-o", target, *(["--store", "cache"] if source == "sweep" else [])]) == 0
    assert contents(Path("from-directory")) == contents(Path("from-bundle"))
    assert "the 3 fittest elites" in (place / "from-bundle" / "ablation_test_mse.md").read_text()
    capsys.readouterr()
    assert main(["plan", "sweep", "sweep", "--effect", "0.5", "-o", "planned"]) in {0, 1}
    assert "chosen among 3 elites" in capsys.readouterr().out
