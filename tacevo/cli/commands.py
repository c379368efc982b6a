"""Every command: its arguments are a signature, its help is a docstring, and its body names what does the work.

What does the work takes seconds to import. So it is imported when the arguments go together and what they name is
there, and `tacevo COMMAND --help` waits for none of it.
"""

import argparse
import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from tacevo.choices import Primary
from tacevo.cli.common import FORMATS, Format, check_names, place_of_results, places_of, tell, whole_number
from tacevo.cli.signature import AT_LEAST_ONE, HIDDEN, REPEATED, Command, Takes, UsageError, command
from tacevo.parts.kinds import COMMAND_GROUPS
from tacevo.storage.places import check_place, check_sweep, sibling


def _place(text: str) -> str:
    """Read the path of a run or a sweep.

    Raises:
        RunError: nothing is there.
    """
    check_place(Path(text))
    return text


def _sweep_place(text: str) -> str:
    """Read the path of a sweep.

    Raises:
        RunError: nothing is there, or a run.
    """
    check_sweep(Path(text))
    return text


def _run_or_setting(word: str) -> str:
    """Read what may be the path of a run, alone or as a setting; a path in quotes, or with others, is read later."""
    key, _, value = word.partition("=")
    if value and key in {"run", "sweep"} and not set(value) & set("'\"\\${}[],"):
        check_place(Path(value))
    elif "=" not in word:
        check_place(Path(word))
    return word


def _configs(text: str) -> str:
    if Path(text).is_dir():
        return text
    remedy = sibling(Path(text))
    meant = f"; {remedy}" if remedy else ""
    raise argparse.ArgumentTypeError(f"expected a directory of configs, as `tacevo init` writes one; got {text}{meant}")


def _share(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0 < (value := float(text)) < 1:
            return value
    raise argparse.ArgumentTypeError(f"expected a number between 0 and 1, such as 0.1 for 10 %; got {text}")


def _whole(text: str) -> int:
    with contextlib.suppress(ValueError):
        return int(text)
    raise argparse.ArgumentTypeError(f"expected an integer; got {text}")


def _part(text: str) -> tuple[int, int]:
    number, _, parts = text.partition("/")
    if number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts):
        return int(number), int(parts)
    raise argparse.ArgumentTypeError(f"expected a part of several, such as 1/4; got {text}")


Run = Annotated[str, Takes("RUN", _place)]

SweepPlace = Annotated[str, Takes("SWEEP", _sweep_place)]

RunOrSetting = Annotated[str, Takes("RUN or SETTING", _run_or_setting)]

Override = Annotated[str, Takes("OVERRIDE")]

Configs = Annotated[str, Takes("DIR", _configs)]

Dir = Annotated[str, Takes("DIR")]

File = Annotated[str, Takes("FILE")]

Name = Annotated[str, Takes("NAME")]

Candidate = Annotated[str, Takes("CANDIDATE")]

Count = Annotated[int, Takes("N", whole_number)]

Share = Annotated[float, Takes("SHARE", _share)]


def _more(name: str) -> Callable[[], str]:
    """Return a function of `tacevo.cli.settings`, which is imported when the help is written."""

    def write() -> str:
        from tacevo.cli import settings

        written: str = getattr(settings, name)()
        return written

    return write


def _reading(*runs: str) -> None:
    """Say what is read, before imports that take seconds."""
    for run in runs:
        tell(f"reading {run}", error=True)


@command(reads_files=True, more=_more("of_search"))
def search(
    *overrides: Override,
    estimate: bool = False,
    cfg: Literal["job"] | None = None,
    resolve: Annotated[bool, HIDDEN] = False,
    info: Annotated[str, Takes("WHAT", bare="all"), HIDDEN] | None = None,
    multirun: bool = False,
    into: Dir | None = None,
    reference: Annotated[str, Takes("ARM")] | None = None,
    primary: Primary | None = None,
    vary: Annotated[str, Takes("KEYS")] | None = None,
    plan: File | None = None,
    config_dir: Configs | None = None,
) -> int:
    """Run a search or a sweep, or continue one that was stopped.

    Run a search. The same command continues a stopped run, and repeats a finished one in seconds. Most searches set
    these alone: experiment=NAME, its size; llm=NAME, the model that is asked; task=NAME and data=NAME data.root=DIR,
    the images; seed=N.

    Examples:
      # a small search, in minutes
      tacevo search experiment=demo
      # what a search with a model would cost, without asking it
      tacevo search --estimate experiment=paper_force llm=anthropic
      tacevo search experiment=paper_force llm=anthropic llm.budget_usd=5
      # a sweep of four searches: two arms, two seeds
      tacevo search -m experiment=demo ablation=none,drift seed=0,1
      # ten seeds: quote what has brackets
      tacevo search -m experiment=demo 'seed=range(0,10)'

    Args:
        overrides: GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line
        estimate: print requests, tokens, cost and hours; send nothing
        cfg: print the composed settings as YAML, and run nothing
        resolve: the same as --cfg job, for who knows Hydra
        info: the same, for who knows Hydra
        multirun: run all combinations of overrides with several values, as in seed=0,1,2; hydra.launcher.n_jobs=N sets
            how many at once, hydra/launcher=submitit_slurm submits them to Slurm
        into: the directory of the sweep (default: one in sweeps/, named after what its jobs share)
        reference: of a sweep: the arm that others are compared with (default: none, if it is one)
        primary: of a sweep: what arms are compared by first (default: test_score, which `tacevo study sweep=DIR`
            gives; new_quartile with data=table)
        vary: of a sweep: settings that take each job's seed as their value, as in data.split_seed,data.sensor_seed
        plan: of a sweep: the plan.json of `tacevo plan sweep` that it follows
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli import search as work

    if cfg or resolve or info:
        return work.show_settings(overrides)
    if into is not None and not multirun:
        raise UsageError("--into names the directory of a sweep, so it needs -m; for one search, set run.dir=DIR")
    if not multirun and any(said is not None for said in (reference, primary, vary, plan)):
        raise UsageError("--reference, --primary, --vary and --plan are terms of a sweep, so they need -m")
    asked = work.terms(primary=primary, reference=reference, vary=vary, plan=plan)
    if estimate:
        return work.estimate(overrides, asked if multirun else None)
    return work.run_sweep(overrides, into, asked) if multirun else work.run_one(overrides)


@command()
def extend(
    run: Run,
    *overrides: Override,
    store: Dir | None = None,
    trust_parts: bool = False,
    config_dir: Configs | None = None,
) -> int:
    """Search on from the end of a published run.

    Replay a finished run, and search on from its end in a new run directory, whose ledger begins with the lines of the
    published one. The published run and its stores are only read.

    Examples:
      tacevo extend cache/published/grating-grammar.zip search.generations=30
      tacevo extend runs/NAME search.generations=30 run.dir=runs/LONGER

    Args:
        run: the directory or bundle of a run, or SWEEP.zip/JOB
        overrides: GROUP=CHOICE or KEY=VALUE, as in Hydra; a larger search.generations is needed
        store: the directory of its stores, if they were moved
        trust_parts: let parts that the run's user brought decide again, by their recorded sources in confined processes
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    _reading(run)
    from tacevo.cli.reproduce import run_extend

    return run_extend(run, overrides, store=store, trusts=trust_parts)


@command(reads_files=True, more=_more("of_study"))
def study(*overrides: RunOrSetting, config_dir: Configs | None = None) -> int:
    r"""Train a run's best networks and the baseline fully, with many seeds, and test them.

    Train the baseline and the best elites of a finished run, or of each job of a sweep, or networks of your own, fully,
    each with the same training seeds, and measure them on the test images. The exit status is 1 if a training or a job
    did not finish; with choose=validated a training that chooses may fail, and costs its elite the place.

    Examples:
      tacevo study runs/NAME
      tacevo study runs/NAME elites=2 seeds=5 epochs=10 executor.workers=8
      tacevo study runs/NAME margins.regression.value=0.05
      # the same networks on other data: any setting of data
      tacevo study runs/NAME data.split_seed=7
      # for `tacevo ablations`, which compares arms by these scores; of two arms
      tacevo study sweep=sweeps/NAME seeds=5
      tacevo study sweep=sweeps/NAME arms=none,drift
      # networks of your own, also on several data sets, with a table of them
      tacevo study networks=library/force/published task=force data.image_size=64
      tacevo study networks=[a.py,b.py] task=grating data=tacverse \
          data.root=DIR data.sensor=A,B
      # the baseline alone
      tacevo study task=hardness

    Beside networks= and task=, settings of `tacevo search` hold for the run that the networks are recorded in: task,
    data, training, numerics, gate, sandbox, seed, experiment, tracking and run.dir.

    The same command continues what was stopped. Several processes, on one or more machines that share the run and the
    store, divide the work.

    Args:
        overrides: RUN, the directory of a run; KEY=VALUE, or @FILE with one of them a line
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.study import run_study

    return run_study(overrides)


@command(reads_files=True, more=_more("of_noise"))
def noise(*overrides: RunOrSetting) -> int:
    """Train a run's elites again with other seeds, to see how much of each fitness was luck.

    Train the baseline and the elites of a finished run, or of each job of a sweep, again as its search did, but with
    other training seeds, so that tables and report can say what its recorded fitnesses are worth. No test image is
    used. The exit status is 1 if a training or a job did not finish.

    Examples:
      tacevo noise runs/NAME
      tacevo noise runs/NAME elites=10 seeds=20 executor.workers=8
      tacevo noise sweep=sweeps/NAME

    The same command continues what was stopped. Several processes, on one or more machines that share the run and the
    store, divide the work.

    Args:
        overrides: RUN, the directory of a run; KEY=VALUE, or @FILE with one of them a line
    """
    from tacevo.cli.noise import run_noise

    return run_noise(overrides)


@command()
def tabulate(*overrides: Override, output: File, seeds: Count = 1, config_dir: Configs | None = None) -> int:
    """Train every network of a closed space, for searches that look evaluations up.

    Probe every network of a closed space (llm.space) and train it fully, for training.epochs epochs with each of some
    seeds; write all of it into one file, for searches with data=table. The same command continues a stopped one.

    Examples:
      tacevo tabulate experiment=space --output table.zip
      tacevo search experiment=table data.table=table.zip

    Args:
        overrides: GROUP=CHOICE or KEY=VALUE, as in Hydra
        output: the file to write, such as table.zip
        seeds: trainings of each network (1)
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.tabulate import run_tabulate

    return run_tabulate(overrides, output, seeds)


@command()
def judge(
    table: File,
    *overrides: Override,
    output: File,
    networks: Count = 96,
    seeds: Count = 20,
    part: Annotated[tuple[int, int] | None, Takes("K/N", _part)] = None,
) -> int:
    """Train the best networks of a table with fresh seeds, which judge what its own seeds choose.

    The networks that a model of the genes puts first are trained with seeds that no search sees, and the table is
    written with these trainings as its judge. The same command continues a stopped one. Several processes can share the
    work: each trains a part, and one without --part writes the file in the end.

    Examples:
      tacevo judge space.zip -o judged.zip --part 1/4
      tacevo judge space.zip -o judged.zip executor.workers=8

    Args:
        table: the table, as `tacevo tabulate` writes it
        overrides: settings of executor, store and device, as in Hydra; all others are the table's
        output: the file to write; it may be the table itself, and a judge there is replaced by one that holds it
        networks: how many are judged (96)
        seeds: fresh seeds of each (20)
        part: train only part K of N, and write no file
    """
    from tacevo.cli.judge import run_judge

    return run_judge(table, overrides, output, networks=networks, seeds=seeds, part=part)


@command()
def plan_study(
    *runs: Annotated[Run, AT_LEAST_ONE],
    effect: Share,
    comparisons: Count | None = None,
    power: Share = 0.8,
    alpha: Share = 0.05,
    output: Dir = "build/plan",
    sign: Annotated[File | None, Takes("KEY")] = None,
) -> int:
    """Plan the training seeds of each network.

    Examples:
      tacevo plan study cache/published/grating-grammar.zip --effect 0.01
      tacevo study runs/NAME seeds=SEEDS plan=build/plan/plan.json

    Args:
        runs: a pilot run (directory or bundle; all its finished studies are used), or the directory of one study
        effect: what is to be found: a part of an error (0.1 is 10 % less), or the difference of an accuracy
        comparisons: variants (default: as many as the pilot)
        power: wished chance of finding it (0.8)
        alpha: level of the tests, after Holm (0.05)
        output: directory to write to (default: build/plan)
        sign: sign the plan with this SSH key, before anything of it is trained
    """
    _reading(*runs)
    from tacevo.cli.plan import run_plan

    return run_plan("study", runs, output, sign, effect=effect, comparisons=comparisons, power=power, alpha=alpha)


@command()
def plan_sweep(
    *runs: Annotated[SweepPlace, AT_LEAST_ONE],
    effect: Share,
    comparisons: Count | None = None,
    power: Share = 0.8,
    alpha: Share = 0.05,
    output: Dir = "build/plan",
    sign: Annotated[File | None, Takes("KEY")] = None,
) -> int:
    """Plan the jobs of each arm.

    Examples:
      tacevo plan sweep sweeps/PILOT --effect 0.05 --comparisons 3 -o plans
      tacevo search -m ... 'seed=range(0,SEEDS)' --plan plans/plan.json

    Args:
        runs: a pilot sweep (directory or bundle)
        effect: what is to be found: a part of an error (0.1 is 10 % less), or the difference of an accuracy
        comparisons: arms beside the reference (default: as many as the pilot)
        power: wished chance of finding it (0.8)
        alpha: level of the tests, after Holm (0.05)
        output: directory to write to (default: build/plan)
        sign: sign the plan with this SSH key, before anything of it is trained
    """
    _reading(*runs)
    from tacevo.cli.plan import run_plan

    return run_plan("sweep", runs, output, sign, effect=effect, comparisons=comparisons, power=power, alpha=alpha)


_PLAN = """\
Compute how many seeds are needed to detect an effect of a given size, and the cost.

Compute how many seeds are needed to detect an effect of a given size after Holm's correction, and the cost. The spread
is that of finished pilot runs. The exit status is 1 if no number of seeds that is tried suffices.

Examples:
  tacevo plan study cache/published/grating-grammar.zip --effect 0.01
  tacevo plan sweep sweeps/PILOT --effect 0.05 --comparisons 3 -o plans
  tacevo study runs/NAME seeds=SEEDS plan=build/plan/plan.json
  tacevo search -m ... 'seed=range(0,SEEDS)' --plan plans/plan.json

The plan is kept in the study or the sweep that it is given to. docs/statistics.md says how it is simulated."""


@command()
def replay(
    run: Run,
    *,
    store: Dir | None = None,
    retrain: Annotated[Count, Takes("N", whole_number, bare=0)] | None = None,
    trust_parts: bool = False,
    draw: Annotated[int, Takes("SEED", whole_number)] | None = None,
    table: File | None = None,
    allowed_signers: File | None = None,
) -> int:
    """Run a recorded search again from its stores and compare.

    Run a recorded search and its finished studies again, without model, training or data set, and compare every line;
    of a sweep, every search. With --retrain, also train the candidates again. A published run or sweep is replayed from
    its own records, with every table.

    Examples:
      # a published run, from the records in it
      tacevo replay cache/published/grating-claude.zip
      # and train its best network and five others again, bit for bit
      tacevo replay cache/published/grating-claude.zip --retrain 5
      tacevo replay runs/NAME
      # a sweep, and one job of a published one
      tacevo replay sweeps/NAME
      tacevo replay cache/published/ablation-elites.zip/none-seed0

    Args:
        run: the directory of a run or a sweep, or a file that `tacevo publish` wrote; SWEEP.zip/JOB is one run of it
        store: the directory of its stores, if they were moved; for a published run, where --retrain keeps images
        retrain: then train the candidates again and compare every bit; with N the best network, the networks of
            studies, and N others that are drawn at random
        trust_parts: let parts that the run's user brought decide again, by their recorded sources in confined processes
        draw: draw the N as an earlier replay did, which told its seed
        table: with --retrain of searches that looked evaluations up: the table (default: that of their digest, where it
            was, beside RUN, or in cache/tables)
        allowed_signers: names and public keys of those who may have signed the file, and fail if none of them did
    """
    if draw is not None and not retrain:
        raise UsageError("--draw repeats the draw of --retrain N; give both")
    if table is not None and retrain is None:
        raise UsageError("--table names the table that --retrain looks searches up in; give both")
    _reading(run)
    from tacevo.cli.reproduce import run_replay

    return run_replay(
        run, store=store, others=retrain, trusts=trust_parts, draw=draw, table=table, allowed=allowed_signers
    )


@command(interrupted="the directory is whole or absent")
def export(
    run: Run,
    candidate: Candidate,
    *overrides: Annotated[str, Takes("KEY=VALUE")],
    output: Dir,
    store: Dir | None = None,
    retrained: bool = False,
) -> int:
    """Take a network away: its weights, ONNX, a model card.

    Train a candidate again in the sandbox, and write it as a directory that needs no tacevo: the class, its weights,
    ONNX where it can hold the network, a model card. Needs `pip install -e '.[export]'`.

    Examples:
      tacevo export runs/NAME g02s03 -o network
      # five trainings, whose mean answer is the model's
      tacevo export runs/NAME g02s03 seeds=5 -o ensemble
      # as the search trained it
      tacevo export runs/NAME g02s03 like=search -o short

    Args:
        run: the directory or bundle of a run, or SWEEP.zip/JOB
        candidate: its id, e.g. g02s03
        overrides: seeds=K, an ensemble of K trainings; epochs=N; like=study, the default, or like=search; licence=ID;
            data.root=DIR, if the data set was moved
        output: the directory, which must not exist
        store: the directory of its stores, if they were moved
        retrained: fail where a training is not recorded, or goes otherwise than recorded
    """
    _reading(run)
    from tacevo.cli.export import run_export

    return run_export(run, candidate, overrides, output, store=store, retrained=retrained)


@command(interrupted="nothing was written; the same command begins again")
def publish(
    run: Run,
    *studies: Annotated[str, Takes("STUDY")],
    output: File,
    store: Dir | None = None,
    licence: Annotated[str, Takes("SPDX")] = "CC-BY-4.0",
    author: Annotated[Sequence[str], Takes("NAME"), REPEATED] = (),
    date: Annotated[str, Takes("YYYY-MM-DD")] = "",
    sign: Annotated[File | None, Takes("KEY")] = None,
    deposit: Dir | None = None,
) -> int:
    """Write one file with which anybody can replay a run or a sweep.

    Replay a finished run or sweep and its studies, and write all that a replay elsewhere needs, with tables, figures,
    licence and checksums, into one file: an RO-Crate.

    Examples:
      tacevo publish runs/NAME -o NAME.zip --author 'Ada Lovelace'
      tacevo publish sweeps/NAME -o NAME.zip --license CC0-1.0
      tacevo publish runs/NAME -o NAME.zip --sign ~/.ssh/id_ed25519
      # what Zenodo wants: upload all files of this directory
      tacevo publish runs/NAME -o x.zip --author 'A. Lovelace' --deposit DIR

    Args:
        run: the directory of a run or of a sweep
        studies: the directory of a study of a run (default: all finished ones)
        output: e.g. run.zip
        store: the directory of the run's stores, if they were moved
        licence: of what is published (default: CC-BY-4.0)
        author: may be given several times
        date: of publication (default: the end of the run)
        sign: sign the bundle digest with this SSH key, into a file beside the bundle; the key itself stays where it is
        deposit: lay out bundle, README, licence, citation, checksums and .zenodo.json here, for a research archive
    """
    _reading(run)
    from tacevo.cli.publish import run_publish

    return run_publish(
        run, studies, output, store=store, licence=licence, authors=author, date=date, key=sign, deposited=deposit
    )


@command()
def cache_verify(*, store: Dir = "cache") -> int:
    """Check every entry; the exit status is 1 if one is damaged.

    Examples:
      tacevo cache verify

    Args:
        store: directory of the stores (default: cache)
    """
    from tacevo.cli.cache import verify_entries

    return verify_entries(Path(store))


@command()
def cache_export(run: Run, *, output: File, store: Dir | None = None) -> int:
    """Write exactly the entries that a run needs into one file.

    Examples:
      tacevo cache export runs/NAME --output entries.xz

    Args:
        run: the directory of a run
        output: the file to write
        store: the directory of its stores, if they were moved
    """
    from tacevo.cli.cache import export_entries

    return export_entries(Path(run), Path(output), store)


@command()
def cache_import(file: File, *, store: Dir = "cache") -> int:
    """Verify such a file, then write its entries into the stores.

    Examples:
      tacevo cache import entries.xz --store cache

    Args:
        file: the file to read
        store: directory of the stores (default: cache)
    """
    from tacevo.cli.cache import import_entries

    return import_entries(Path(file), Path(store))


@command()
def cache_prune(*runs: Dir, store: Dir = "cache", yes: bool = False) -> int:
    """Remove the entries that no run here needs, after a question.

    Examples:
      tacevo cache prune runs sweeps

    Args:
        runs: directories of runs (default: this one)
        store: directory of the stores (default: cache)
        yes: ask nothing
    """
    from tacevo.cli.cache import prune_entries

    return prune_entries([Path(run) for run in runs or (".",)], store, yes=yes)


@command()
def show(run: Run, candidate: Candidate | None = None, *, source: bool = False) -> int:
    """Show what a run found, one candidate of it, or how far the jobs of a sweep are.

    Examples:
      tacevo show runs/NAME
      tacevo show runs/NAME g02s03
      # its class alone, as a file
      tacevo show runs/NAME g02s03 --source > network.py
      tacevo show sweeps/NAME

    Args:
        run: the directory or bundle of a run or a sweep, or SWEEP.zip/JOB
        candidate: its id, e.g. g02s03
        source: only its source, with the imports that it was given
    """
    if source and candidate is None:
        raise UsageError("--source is of a candidate; name one")
    _reading(run)
    from tacevo.cli.show import run_show

    return run_show(run, candidate, only_source=source)


@command(interrupted="every written file is complete; run the same command again for the rest")
def tables(
    *runs: Run,
    paper: bool = False,
    latex: bool = False,
    columns: Annotated[Sequence[str], Takes("NAME")] = (),
    notes: Literal["none", "short", "full"] = "full",
    output: Dir | None = None,
    store: Dir | None = None,
) -> int:
    """Write every table of runs and sweeps, those that a paper needs first.

    Write every table of finished runs and sweeps as .tex, .md and .csv, and print those that a paper needs; index.md
    says which question each answers.

    Examples:
      tacevo tables runs/NAME
      tacevo tables cache/published/grating-claude.zip -o tables
      # for a paper: LaTeX on the screen, two columns, short notes
      tacevo tables runs/NAME --latex --columns median verdict --notes short

    Args:
        runs: the directory or bundle of a run or a sweep, or SWEEP.zip/JOB; optional with --paper
        paper: the paper's own tables, too, and one beside the runs
        latex: print LaTeX instead of Markdown
        columns: show only these beside the first one, where a table has any of them; .csv has all
        notes: below a table: none, the first sentence of each, or all (default: full)
        output: where to write (default: RUN/tables; several need it, and go to DIR/NAME)
        store: directory of the stores, if it was moved
    """
    places = places_of(runs, output, "tables") if runs else []
    if not runs and not paper:
        raise UsageError("name a run or a sweep, or give --paper for the paper's tables")
    _reading(*runs)
    from tacevo.cli.tables import run_tables

    return run_tables(runs, places, output, store=store, paper=paper, latex=latex, columns=columns, notes=notes)


@command(interrupted="every written file is complete; run the same command again for the rest")
def figures(
    *runs: Annotated[Run, AT_LEAST_ONE],
    format: Sequence[Format] = FORMATS,
    output: Dir | None = None,
    store: Dir | None = None,
) -> int:
    """Draw every figure of runs and sweeps, for a paper.

    Draw every figure of finished runs and their studies, and of sweeps.

    Examples:
      tacevo figures runs/NAME
      tacevo figures cache/published/grating-claude.zip -o figures --format pdf

    Args:
        runs: the directory or bundle of a run or a sweep, or SWEEP.zip/JOB
        format: of the files (default: all three)
        output: where to write (default: RUN/figures; several need it, and go to DIR/NAME)
        store: directory of the stores, if it was moved
    """
    places = places_of(runs, output, "figures")
    _reading(*runs)
    from tacevo.cli.figures import run_figures

    return run_figures(runs, places, formats=format, store=store)


@command(interrupted="every written file is complete; run the same command again for the rest")
def report(
    *runs: Annotated[Run, AT_LEAST_ONE],
    output: Annotated[str, Takes("PLACE")] | None = None,
    follow: bool = False,
    latex: bool = False,
    store: Dir | None = None,
) -> int:
    """Write one page to look into a run or a sweep, or a LaTeX document of several.

    Write one HTML file with which a finished run and its studies, or a finished sweep, can be looked into; or with
    --latex every table and figure of several, in a LaTeX document, and its PDF where LaTeX is installed.

    Examples:
      tacevo report runs/NAME
      # while the search is at work: the page reloads itself
      tacevo report runs/NAME --follow
      tacevo report cache/published/grating-claude.zip -o claude.html
      # every table and figure of two runs, in a document
      tacevo report --latex runs/ONE runs/TWO -o paper

    Args:
        runs: the directory or bundle of a run or a sweep, or SWEEP.zip/JOB
        output: file to write (default for a directory: RUN/report.html), or with --latex directory (build/paper)
        follow: write the page again while searches are at work, until they are finished; it reloads itself
        latex: write a LaTeX document of all, with their tables and figures
        store: directory of the stores, if it was moved
    """
    if latex:
        check_names(runs)
        if follow:
            raise UsageError("--follow writes a page again, so it does not go with --latex")
        _reading(*runs)
        from tacevo.cli.document import run_document

        return run_document(runs, output or "build/paper", store)
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} runs have no page together; with --latex they have a document")
    path = place_of_results(runs[0], output, "report.html")
    _reading(*runs)
    from tacevo.cli.report import run_report

    return run_report(runs[0], path, follows=follow, store=store)


@command(interrupted="every written file is complete; run the same command again for the rest")
def ablations(
    sweep: SweepPlace,
    *,
    format: Sequence[Format] = FORMATS,
    output: Dir | None = None,
    reference: Annotated[str, Takes("ARM")] | None = None,
    store: Dir | None = None,
) -> int:
    """Compare the arms of a sweep: tables and figures.

    Compare the arms of a sweep by its finished jobs: print a table of them, and write all as .tex, .md and .csv, with
    figures as .pdf, .svg and .png.

    Examples:
      tacevo search -m experiment=demo ablation=none,drift seed=0,1
      tacevo study sweep=sweeps/NAME seeds=5 epochs=5
      tacevo ablations sweeps/NAME
      tacevo ablations cache/published/ablation-proposals.zip -o mine

    Args:
        sweep: the directory or bundle of a sweep
        format: of the figures' files (default: all three)
        output: where to write (default: SWEEP/ablations)
        reference: the arm to compare with (default: the one that the sweep states, or none)
        store: directory of the stores, if it was moved
    """
    place = place_of_results(sweep, output, "ablations")
    _reading(sweep)
    from tacevo.cli.figures import run_ablations

    return run_ablations(sweep, place, reference, formats=format, store=store)


@command(interrupted="every written file is complete; run the same command again for the rest")
def pairs(
    sweep: SweepPlace,
    *,
    output: Dir | None = None,
    reference: Annotated[str, Takes("ARM")] | None = None,
    other_parents: bool = False,
    store: Dir | None = None,
) -> int:
    r"""Compare the arms of a sweep answer by answer: the same questions, asked in other ways.

    In the first generation after generation 0 the arms of a seed ask a model for children of the same parents by the
    same instructions, so two answers differ by nothing but what tells the arms apart. Print the tables, and write them
    as .tex, .md and .csv.

    Examples:
      tacevo search -m experiment=pairs llm=anthropic \
          'prompts.tells=[],[fitness]' seed=0,1,2 --into sweeps/tells
      tacevo pairs sweeps/tells

    Args:
        sweep: the directory or bundle of a sweep
        output: where to write (default: SWEEP/pairs)
        reference: the arm to compare with (default: the one that the sweep states, else none, or the first)
        other_parents: compare arms that differ by search.networks, whose parents are other networks at the same places
        store: directory of the stores, if it was moved
    """
    place = place_of_results(sweep, output, "pairs")
    _reading(sweep)
    from tacevo.cli.pairs import run_pairs

    return run_pairs(sweep, place, reference, store, other_parents=other_parents)


@command(interrupted="nothing half-made is left")
def init(
    name: Name,
    *,
    like: Annotated[str, Takes("TASK")] | None = None,
    from_supplement: File | None = None,
    part: Annotated[str, Takes("KIND")] | None = None,
    config_dir: Dir | None = None,
) -> int:
    """Write a task of your own, or a part, to be edited.

    Write a task of your own into ./conf: the settings, the baseline and the texts of another task under a new name, to
    be edited. Searches that start in this directory know it. With --part, write a part into ./parts that works at once,
    and its test. Nothing that exists is changed.

    Examples:
      tacevo init shear --like force
      tacevo search experiment=demo task=shear
      tacevo init width --part descriptors
      tacevo parts check parts/width.py

    Args:
        name: of the new task or part: a lower-case identifier, e.g. shear
        like: the task to copy (default: force)
        from_supplement: your copy of the index.html of the paper's supplement: its instructions and system prompt
            become those of the new task, for forces or gratings as NAME begins, or as --like says
        part: write a part of this kind instead of a task; one of those that `tacevo parts` lists
        config_dir: the directory of configs to write into, which is made (default: conf)
    """
    if part is not None:
        if like or from_supplement or config_dir:
            raise UsageError("--part writes a part, and no task; leave --like, --from-supplement and --config-dir out")
        from tacevo.cli.new_part import run_init_part

        return run_init_part(name, part)
    from tacevo.cli.init import run_init

    return run_init(name, like, from_supplement, config_dir)


@command(reads_files=True)
def data_check(
    *overrides: Override, output: File | None = None, json: bool = False, config_dir: Configs | None = None
) -> int:
    """Load a data set as a search would, count it, and draw a contact sheet.

    Load a data set as a search would, count it, and draw a contact sheet. The exit status is 1 if two splits share an
    image.

    Examples:
      tacevo data check task=force
      tacevo data check data=csv data.root=IMAGES data.table=labels.csv -o sheet.png

    Args:
        overrides: GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line
        output: the contact sheet: .png, .pdf or .svg
        json: the findings as one JSON object
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.data import check_data

    return check_data(overrides, output, as_json=json)


@command(reads_files=True)
def data_show(
    *overrides: Override,
    output: File,
    width: Literal["single", "double"] = "double",
    config_dir: Configs | None = None,
) -> int:
    """Draw a few samples with their labels, for a paper.

    Draw a few samples with their labels: one of each class or level, or from the least to the most.

    Examples:
      tacevo data show task=grating -o gratings.pdf

    Args:
        overrides: GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them a line
        output: the figure: .png, .pdf or .svg
        width: columns of a paper
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.data import show_data

    return show_data(overrides, output, width)


@command(reads_files=True)
def data_simulate(*overrides: Annotated[str, Takes("SETTING"), AT_LEAST_ONE], config_dir: Configs | None = None) -> int:
    """Write a simulated data set as images and a table of labels.

    Write a simulated data set as images and a table of labels; the directory is whole or absent.

    Examples:
      tacevo data simulate task=force n=3000 out=simulated

    Args:
        overrides: out=DIR, n=IMAGES, or an override: GROUP=CHOICE or KEY=VALUE, as in Hydra, or @FILE with one of them
            a line
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.data import simulate_data

    return simulate_data(overrides)


_DATA = """\
Look at a data set, or write a simulated one as files.

Look at a data set before a search, or write a simulated one as files.

Examples:
  tacevo data check task=force
  tacevo data check experiment=published_force data=tacverse data.root=DIR
  tacevo data show task=grating -o gratings.pdf
  tacevo data simulate task=force n=3000 out=simulated"""


@command()
def check(
    *files: Annotated[File, AT_LEAST_ONE],
    task: Name = "force",
    image_size: Annotated[int, Takes("PIXELS", _whole)] | None = None,
    json: bool = False,
    config_dir: Configs | None = None,
) -> int:
    """Put raw answers of a model through the gate.

    Put raw answers through the gate: text files, or JSON recordings with a `response`. The exit status is 0 also where
    answers are rejected; --json says which. It is 2 where a file cannot be read; the others are judged all the same.

    Examples:
      tacevo check answer.txt --task grating
      tacevo check conf/library/shear/baseline.py --task shear --json

    Args:
        files: a text file, or JSON with a `response` or `source`
        task: whose contract to apply (default: force)
        image_size: side of the images (default: that of the task's data)
        json: one JSON object a line
        config_dir: tasks and other configs of your own, beside those of tacevo (default: conf, where there is one)
    """
    from tacevo.cli.inspect import run_check

    return run_check(files, task, image_size, as_json=json)


@command(interrupted="nothing was changed")
def parts(
    kind: Annotated[str, Takes("KIND | check")] | None = None,
    part: Annotated[str, Takes("PART")] | None = None,
    *overrides: Override,
) -> int:
    """List what can be plugged in, and check a part of your own.

    List the parts that are installed, of all kinds or of one, and import none of them. `tacevo parts check PART`
    imports a part, makes it with its settings, tries whether it keeps the contracts of its kind, and prints a line for
    each; the exit status is 1 where one is broken. It runs the code of the part in this process.

    Examples:
      tacevo parts
      tacevo parts archives
      tacevo parts check parts/mine.py

    Args:
        kind: one of the kinds that `tacevo parts` lists; or `check`
        part: with `check`: a name, FILE.py:CLASS, FILE.py for all parts in it, or SETTING=NAME as a search has it
        overrides: its settings, GROUP=CHOICE or KEY=VALUE, as in Hydra; of an output run=RUN, which it is tried with
    """
    from tacevo.cli.parts import run_parts

    return run_parts(kind, part, overrides, {name: each.line for name, each in OURS.items()})


@command(interrupted="what is in MLflow stays, and the same command writes the rest")
def track(directory: Dir, *, uri: Annotated[str, Takes("URI")] = "") -> int:
    """Write the ledgers of runs into MLflow, or what is missing of them there.

    Mirror a run directory into MLflow, or those of a sweep, or all below a directory. A second time writes nothing
    twice. The exit status is 1 if a run of several could not be written.

    Examples:
      tacevo track runs/NAME
      tacevo track runs --uri sqlite:///mlflow.db

    Args:
        directory: the directory of a run, of a sweep, or one that contains such
        uri: MLflow tracking URI (default: each run's own, else MLFLOW_TRACKING_URI)
    """
    from tacevo.cli.track import run_track

    return run_track(directory, uri)


@command()
def doctor(*, report: File | None = None) -> int:
    """Check whether this machine has what a run needs.

    Check what a run needs of this machine: packages, sandbox, directory, and the bits of portable numerics, which are
    computed and compared with the recorded ones. The exit status is 1 where a check fails, or bits differ or cannot be
    computed.

    Examples:
      tacevo doctor
      tacevo doctor --report machine.json

    Args:
        report: write what this CPU computes to FILE (JSON), to be sent to the project
    """
    from tacevo.cli.inspect import run_doctor

    return run_doctor(report)


plan = Command(doc=_PLAN, below={"study": plan_study, "sweep": plan_sweep})

_CACHE = """\
Look into the stores of answers, move what a run needs, remove what none does.

Examples:
  tacevo cache verify
  tacevo cache export runs/NAME --output entries.xz
  tacevo cache import entries.xz
  tacevo cache prune runs sweeps"""

cache = Command(
    doc=_CACHE,
    below={"verify": cache_verify, "export": cache_export, "import": cache_import, "prune": cache_prune},
)

data = Command(
    doc=_DATA,
    below={"check": data_check, "show": data_show, "simulate": data_simulate},
    interrupted="nothing half-made is left",
)

#: All commands, by name.
OURS: Mapping[str, Command] = {name: globals()[name] for group in COMMAND_GROUPS.values() for name in group}

#: Those that do not need our package `analysis`.
WITHOUT_ANALYSIS = frozenset({"search", "init", "data", "cache", "parts"})
