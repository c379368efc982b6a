"""Checks of settings that depend on each other; the range of a single one stands at its field."""

import json
import math
import re
from fractions import Fraction
from itertools import combinations
from urllib.parse import urlsplit

from tacevo.choices import (
    OPTIONAL_SAMPLING,
    PAPER_AXES,
    ArchiveKind,
    Axis,
    BoundsRule,
    Confinement,
    DataSource,
    Device,
    ExecutorKind,
    Numerics,
    OperatorScope,
    ParentPolicy,
    Provider,
    Scale,
    SimulatedSensor,
    SplitRule,
    SystemTurn,
)
from tacevo.config.schema import (
    ArchiveConfig,
    DataConfig,
    LLMConfig,
    ProposalsConfig,
    RunConfig,
    TaskConfig,
    TrainingConfig,
    deliveries,
)
from tacevo.errors import ConfigError
from tacevo.records import Kind, Loss, Mode, to_json


def check_together(config: RunConfig) -> None:
    """Compare settings of a run with each other.

    Raises:
        ConfigError: two settings do not go together; the error's place is the one to change.
    """
    _check_task(config.task)
    _check_data(config.data)
    _check_llm(config.llm)
    _check_sampling(config.llm)
    _check_archive(config.archive)
    _check_reevaluations(config)
    _check_proposals(config.proposals)
    _check_parents(config)
    check_device(config)


def doubts_of_settings(config: RunConfig) -> list[str]:
    """Say, a sentence each, what settings that are permitted together will not do."""
    search, proposals = config.search, config.proposals
    if search.generations == 0:
        return []
    pool = 1 + search.initial + search.candidates * (search.generations - 1)  # that the last generation draws from
    if proposals.parents is not ParentPolicy.tournament or proposals.population < pool:
        return []
    return [
        f"proposals.population={proposals.population} never ages: no generation has more than {pool} candidates before "
        "it, so the tournaments are over all; proposals.population=20 proposals.tournament=5 suit a small search"
    ]


def check_device(config: RunConfig) -> None:
    """Raise ConfigError where executor, device, numerics and walls do not go together."""
    executor = config.executor
    if executor.kind is ExecutorKind.local:
        _check_that(executor.address is None, "executor.address", "null without executor=ray", executor.address)
    elif config.training.device is Device.cuda:
        counted = "a number with executor=ray, whose nodes lend GPUs by count"
        _check_that(executor.per_gpu is not None, "executor.per_gpu", counted, executor.per_gpu)
    if config.training.device is Device.cpu:
        is_usual = executor.per_gpu in {1, None}  # a study does not know its run's device, and has null
        _check_that(is_usual, "executor.per_gpu", "1 with training.device=cpu", executor.per_gpu)
    _check_gpu(config)


def _check_gpu(config: RunConfig) -> None:
    training, walls, numerics = config.training, config.sandbox.require, config.numerics.kind
    if training.device is Device.cpu:
        for name in ("gpu", "precision", "gpu_memory_mib", "layout", "captured"):
            value, default = getattr(training, name), getattr(TrainingConfig, name)
            expected = f"{json.dumps(to_json(default))} with training.device=cpu"
            _check_that(value == default, f"training.{name}", expected, value)
        return
    is_here = config.executor.kind is ExecutorKind.local
    known = f"none{' or kernel' if is_here else ''} with training.device=cuda, whose driver needs doors in the walls"
    _check_that(walls is Confinement.none or (is_here and walls is Confinement.kernel), "sandbox.require", known, walls)
    why = "with training.device=cuda, where equal bits are promised on one GPU only"
    _check_that(numerics is Numerics.fast, "numerics.kind", f"fast {why}", numerics)
    why = "with training.device=cuda, whose bits depend on it; `tacevo doctor` names it"
    _check_that(training.gpu is not None, "training.gpu", f"the GPU's model, e.g. 'NVIDIA H200', {why}", training.gpu)


def _check_that(holds: bool, key: str, expected: str, got: object) -> None:
    if not holds:
        raise ConfigError(json.dumps(to_json(got)), place=key, expected=expected)


def _check_task(task: TaskConfig) -> None:
    classes = task.kind is Kind.classification
    _check_that(task.outputs >= 2 or not classes, "task.outputs", "at least 2 for classification", task.outputs)
    loss = Loss.cross_entropy if classes else Loss.mse
    _check_that(task.loss is loss, "task.loss", f"{loss} for {task.kind}", task.loss)


def _check_data(data: DataConfig) -> None:
    simulated = data.source is DataSource.simulated
    most = 256 if simulated else 1024
    _check_that(data.image_size <= most, "data.image_size", f"at most {most} for data={data.source}", data.image_size)
    trained = 1 - Fraction(str(data.validation_part)) - Fraction(str(data.test_part))  # as they are written
    expected = "less than 1 together with data.validation_part, so that images are left for training"
    _check_that(trained > 0, "data.test_part", expected, data.test_part)
    what = "file" if data.source in {DataSource.numpy, DataSource.table} else "directory"
    _check_that(
        simulated or bool(data.root), "data.root", f"the {what} of the data set for data={data.source}", data.root
    )
    columns = data.target_columns
    named = data.source is not DataSource.csv or _distinct(columns)
    _check_that(named, "data.target_columns", "the different columns of the labels, e.g. [fx,fy,fz]", columns)
    named = _distinct(data.spacings_mm) or (not simulated and not data.spacings_mm)
    _check_that(named, "data.spacings_mm", "different spacings, at least one", data.spacings_mm)
    made = not simulated or data.sensor in list(SimulatedSensor)
    _check_that(made, "data.sensor", f"{', '.join(SimulatedSensor)} for data=simulated", data.sensor)
    counted = data.images is not None or not simulated
    _check_that(counted, "data.images", "a number of images for data=simulated", data.images)
    sensors, parts = data.sensor_column, data.split_column
    _check_that(sensors is None or sensors != parts, "data.split_column", "another one than data.sensor_column", parts)
    is_split = data.split is SplitRule.random or sensors is None or parts is not None
    _check_that(is_split, "data.split", "random where no data.split_column names the parts", data.split)
    for name, column in (("sensor_column", sensors), ("split_column", parts)):
        is_level = column is None or data.source is not DataSource.folder or re.fullmatch(r"[1-9]", column)
        expected = "a level of directories with data=folder: 1 for those in data.root, 2 for those in these, up to 9"
        _check_that(bool(is_level), f"data.{name}", expected, column)
    one = data.group_column is None or data.group_pattern is None
    _check_that(
        one, "data.group_pattern", "null beside data.group_column: one of both names the groups", data.group_pattern
    )


def _distinct(values: tuple[object, ...]) -> bool:
    return 0 < len(set(values)) == len(values)


def _check_llm(llm: LLMConfig) -> None:
    sound = llm.base_url is None or _is_address(llm.base_url)
    shown = (llm.base_url or "").rpartition("@")[2]  # an error holds no login
    _check_that(sound, "llm.base_url", "an address such as http://localhost:8000/v1, without ? and #, or null", shown)
    known = llm.delivery in deliveries(llm.provider)
    _check_that(known, "llm.delivery", f"direct for llm={llm.provider}", llm.delivery)
    asked = llm.provider is not Provider.grammar
    _check_that(asked or llm.label is None, "llm.label", f"null for llm={llm.provider}", llm.label)
    closed = None if llm.space is None else to_json(llm.space)
    _check_that(not asked or closed is None, "llm.space", f"null for llm={llm.provider}, which no space binds", closed)
    is_usual = llm.system is SystemTurn.system
    _check_that(asked or is_usual, "llm.system", f"system for llm={llm.provider}", llm.system)
    kept = llm.budget_usd is None or llm.mode is not Mode.live
    _check_that(kept, "llm.budget_usd", "null with llm.mode=live, which pays for every answer again", llm.budget_usd)


def _is_address(value: str) -> bool:
    """Answer whether this is the address of a server, to which a path can be added."""
    if not value.isprintable() or set(value) & set(" ?#"):
        return False
    try:
        parts = urlsplit(value)
        return parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:  # half an IPv6 address, or a port that is not a number
        return False


def _check_sampling(llm: LLMConfig) -> None:
    for key, providers in OPTIONAL_SAMPLING.items():
        value = getattr(llm, key)
        known = llm.provider in providers or not value
        _check_that(known, f"llm.{key}", f"nothing for llm={llm.provider}, which does not have this setting", value)
    thinking, most = llm.thinking_tokens, llm.max_tokens
    fits = thinking is None or thinking < most
    _check_that(fits, "llm.thinking_tokens", f"a number below llm.max_tokens={most}", thinking)


def _check_archive(archive: ArchiveConfig) -> None:
    known = [axes for count in (2, 1) for axes in combinations(Axis, count)]
    *words, last = (f"[{','.join(axes)}]" for axes in known)
    _check_that(archive.axes in known, "archive.axes", f"{', '.join(words)} or {last}", archive.axes)
    whole = archive.kind is not ArchiveKind.best or archive.axes == PAPER_AXES
    expected = f"[{','.join(PAPER_AXES)}] with archive.kind=best, which has no axes"
    _check_that(whole, "archive.axes", expected, archive.axes)
    for key in ("niches", "prompt_niches"):
        value = getattr(archive, key)
        _check_that(value <= archive.samples, f"archive.{key}", f"at most archive.samples={archive.samples}", value)
    logarithmic = archive.bounds is BoundsRule.fixed and archive.eff_ratio_scale is Scale.log
    for axis in Axis:
        key, least = f"{axis}_bounds", 0 if logarithmic and axis is Axis.eff_ratio else -math.inf
        pair = getattr(archive, key)
        _check_that(len(pair) == 2 and pair[0] < pair[1], f"archive.{key}", "[low, high] with low < high", pair)
        _check_that(pair[0] > least, f"archive.{key}", "low > 0 with archive.eff_ratio_scale=log", pair)


def _check_reevaluations(config: RunConfig) -> None:
    if config.archive.kind is not ArchiveKind.extract:
        return
    slots, bound = config.search.candidates, config.search.training_flops
    why = "with archive.kind=extract"
    _check_that(slots >= 2, "search.candidates", f"at least 2 {why}, one of which trains an elite again", slots)
    least = math.ceil(1e6 / slots) / 1e6  # rounded up: it must itself be accepted
    expected = f"at least {least:g}, one slot of search.candidates={slots}, {why}"
    _check_that(config.archive.reevaluations(slots) >= 1, "archive.reevaluated", expected, config.archive.reevaluated)
    _check_that(bound is None, "search.training_flops", f"null {why}, whose re-evaluations it lacks", bound)


def _check_proposals(proposals: ProposalsConfig) -> None:
    p_m, parents = proposals.mutation_probability, proposals.parents
    crosses = parents not in {ParentPolicy.baseline, ParentPolicy.none} or p_m == 1
    why = f"with proposals.parents={parents}, where a crossover lacks a second parent"
    _check_that(crosses, "proposals.mutation_probability", f"1 {why}", p_m)
    drawn = proposals.operator_for is OperatorScope.generation or 0 < p_m < 1
    scope = f"generation with proposals.mutation_probability={p_m:g}"
    _check_that(drawn, "proposals.operator_for", scope, proposals.operator_for)


def _check_parents(config: RunConfig) -> None:
    """Check what the controls need: a provider that draws networks, and niches whose elites are counted."""
    parents, provider, kind = config.proposals.parents, config.llm.provider, config.archive.kind
    draws = parents is not ParentPolicy.none or provider is Provider.grammar
    why = "which cannot draw a network at random: llm=grammar can"
    _check_that(draws, "proposals.parents", f"another one with llm={provider}, {why}", parents)
    counts = parents is not ParentPolicy.best_k or kind is not ArchiveKind.best
    why = "which has no niches to count elites in"
    _check_that(counts, "proposals.parents", f"another one with archive.kind={kind}, {why}", parents)
