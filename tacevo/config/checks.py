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
    AnswerForm,
    BoundsRule,
    Carrier,
    Confinement,
    Device,
    Effort,
    ModelChoice,
    Numerics,
    OperatorScope,
    Scale,
    SimulatedSensor,
    SplitRule,
    SystemTurn,
    Tell,
)
from tacevo.config.recorded_parts import check_code, constant
from tacevo.config.schema import (
    DataConfig,
    LLMConfig,
    RunConfig,
    TaskConfig,
    TemperatureConfig,
    TrainingConfig,
)
from tacevo.errors import ConfigError
from tacevo.parts.kinds import ARCHIVES, PARENTS
from tacevo.records import Kind, Loss, Mode, to_json

#: The most coordinates of the centroids that a user's part may place: they are one entry of a store, and in a bundle a
#: line of 8 MiB at most.
_MOST_COORDINATES = 250_000


def check_together(config: RunConfig) -> None:
    """Compare settings of a run with each other.

    Raises:
        ConfigError: two settings do not go together; the error's place is the one to change.
    """
    _check_task(config.task)
    _check_data(config.data)
    _check_llm(config.llm)
    _check_sampling(config.llm)
    _check_carrier(config)
    check_code(config)
    _check_archive(config)
    _check_proposals(config)
    _check_parents(config)
    check_device(config)


def check_device(config: RunConfig) -> None:
    """Raise ConfigError where executor, device, numerics and walls do not go together."""
    executor = config.executor
    if executor.is_here:
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
    is_here = config.executor.is_here
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
    facts, most = data.facts, data.facts.largest
    _check_that(data.image_size <= most, "data.image_size", f"at most {most} for data={data.source}", data.image_size)
    trained = 1 - Fraction(str(data.validation_part)) - Fraction(str(data.test_part))  # as they are written
    expected = "less than 1 together with data.validation_part, so that images are left for training"
    _check_that(trained > 0, "data.test_part", expected, data.test_part)
    expected = f"the {facts.root} of the data set for data={data.source}"
    _check_that(not facts.root or bool(data.root), "data.root", expected, data.root)
    columns = data.target_columns
    named = "target_columns" not in facts.uses or _distinct(columns)
    _check_that(named, "data.target_columns", "the different columns of the labels, e.g. [fx,fy,fz]", columns)
    named = _distinct(data.spacings_mm) or (not facts.is_made and not data.spacings_mm)
    _check_that(named, "data.spacings_mm", "different spacings, at least one", data.spacings_mm)
    made = not facts.is_made or data.sensor in list(SimulatedSensor)
    _check_that(made, "data.sensor", f"{', '.join(SimulatedSensor)} for data=simulated", data.sensor)
    counted = data.images is not None or not facts.is_made
    _check_that(counted, "data.images", "a number of images for data=simulated", data.images)
    sensors, parts = data.sensor_column, data.split_column
    _check_that(sensors is None or sensors != parts, "data.split_column", "another one than data.sensor_column", parts)
    is_split = data.split is SplitRule.random or sensors is None or parts is not None
    _check_that(is_split, "data.split", "random where no data.split_column names the parts", data.split)
    for name, column in (("sensor_column", sensors), ("split_column", parts)):
        is_level = column is None or facts.names_sensors != "level" or re.fullmatch(r"[1-9]", column)
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
    known = llm.delivery in llm.facts.deliveries
    _check_that(known, "llm.delivery", f"direct for llm={llm.provider}", llm.delivery)
    asked = llm.facts.is_model
    _check_that(asked or llm.label is None, "llm.label", f"null for llm={llm.provider}", llm.label)
    closed = None if llm.space is None else to_json(llm.space)
    _check_that(not asked or closed is None, "llm.space", f"null for llm={llm.provider}, which no space binds", closed)
    several = llm.models
    _check_that(bool(llm.model) or several is not None, "llm.model", "a model's name", llm.model)
    distinct = several is None or (len(several) > 1 and _distinct(llm.names))
    _check_that(distinct, "llm.models", "two models or more, each once; llm.model names a single one", several)
    alone = several is None or llm.label is None
    _check_that(alone, "llm.label", "null with llm.models, whose names are recorded as they are", llm.label)
    learns = several is not None or llm.choice is ModelChoice.weights
    _check_that(learns, "llm.choice", "weights without llm.models", llm.choice)
    even = several is None or llm.choice is ModelChoice.weights or len({weight for _, weight in several}) == 1
    _check_that(even, "llm.models", "names without weights with llm.choice=bandit, which needs none", several)
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
    for key in OPTIONAL_SAMPLING:
        value = getattr(llm, key)
        known = key in llm.facts.sampling or not value
        _check_that(known, f"llm.{key}", f"nothing for llm={llm.provider}, which does not have this setting", value)
    most = llm.max_tokens
    for key in ("thinking", "thinking_tokens"):
        thinking = getattr(llm, key)
        fits = not isinstance(thinking, int) or thinking < most
        _check_that(fits, f"llm.{key}", f"a number below llm.max_tokens={most}", thinking)
    once = llm.thinking is None or llm.thinking_tokens is None
    expected = "null beside llm.thinking: it is an older name of llm.thinking=N"
    _check_that(once, "llm.thinking_tokens", expected, llm.thinking_tokens)


def _check_carrier(config: RunConfig) -> None:
    temperature, llm = config.temperature, config.llm
    if temperature.carrier is not Carrier.effort:
        is_usual = temperature.efforts == TemperatureConfig.efforts
        default = f"[{','.join(TemperatureConfig.efforts)}] without temperature.carrier=effort"
        _check_that(is_usual, "temperature.efforts", default, temperature.efforts)
        return
    known = "effort" in llm.facts.sampling or not llm.facts.is_model
    expected = f"another one with llm={llm.provider}, which has no such setting"
    _check_that(known, "temperature.carrier", expected, temperature.carrier)
    expected = "null with temperature.carrier=effort, by which the temperature chooses it"
    _check_that(llm.effort is None, "llm.effort", expected, llm.effort)
    rising = [effort for effort in Effort if effort in temperature.efforts]
    chooses = len(rising) > 1 and rising == [*temperature.efforts]
    expected = f"at least two of {', '.join(Effort)}, in this order"
    _check_that(chooses, "temperature.efforts", expected, temperature.efforts)


def _check_archive(config: RunConfig) -> None:
    archive = config.archive
    ours = tuple(axis for axis in archive.axes if axis in PAPER_AXES)
    known = [axes for count in (2, 1, 0) for axes in combinations(PAPER_AXES, count)]
    expected = f"one axis or more, each once: {', '.join(PAPER_AXES)} in this order, and descriptors of your own"
    _check_that(ours in known and _distinct(archive.axes), "archive.axes", expected, archive.axes)
    whole = constant(config, ARCHIVES, "has_niches") or archive.axes == PAPER_AXES
    expected = f"[{','.join(PAPER_AXES)}] with archive.kind={archive.kind}, which has no axes"
    _check_that(whole, "archive.axes", expected, archive.axes)
    moves = archive.bounds is BoundsRule.adaptive or ours == archive.axes
    expected = "adaptive with axes of your own, whose bounds no setting has"
    _check_that(moves, "archive.bounds", expected, archive.bounds)
    sampled = ("niches", "prompt_niches") if archive.kind in ARCHIVES.ours else ("prompt_niches",)
    for key in sampled:
        value = getattr(archive, key)
        _check_that(value <= archive.samples, f"archive.{key}", f"at most archive.samples={archive.samples}", value)
    if archive.kind not in ARCHIVES.ours:
        most = _MOST_COORDINATES // len(archive.axes)
        axes = ",".join(archive.axes)
        expected = f"at most {most} with archive.kind={archive.kind} and archive.axes=[{axes}]"
        _check_that(archive.niches <= most, "archive.niches", expected, archive.niches)
    logarithmic = archive.bounds is BoundsRule.fixed and archive.eff_ratio_scale is Scale.log
    for axis in PAPER_AXES:
        key, least = f"{axis}_bounds", 0 if logarithmic and axis == "eff_ratio" else -math.inf
        pair = getattr(archive, key)
        _check_that(len(pair) == 2 and pair[0] < pair[1], f"archive.{key}", "[low, high] with low < high", pair)
        _check_that(pair[0] > least, f"archive.{key}", "low > 0 with archive.eff_ratio_scale=log", pair)


def _check_proposals(config: RunConfig) -> None:
    proposals = config.proposals
    p_m, parents = proposals.mutation_probability, proposals.parents
    crosses = constant(config, PARENTS, "crosses") or p_m == 1
    why = f"with proposals.parents={parents}, where a crossover lacks a second parent"
    _check_that(crosses, "proposals.mutation_probability", f"1 {why}", p_m)
    drawn = proposals.operator_for is OperatorScope.generation or 0 < p_m < 1
    scope = f"generation with proposals.mutation_probability={p_m:g}"
    _check_that(drawn, "proposals.operator_for", scope, proposals.operator_for)


def _check_parents(config: RunConfig) -> None:
    """Check what the controls need: a provider that draws networks, and niches whose elites are counted."""
    parents, provider, kind = config.proposals.parents, config.llm.provider, config.archive.kind
    has_parents = constant(config, PARENTS, "has_parents")
    draws = has_parents or not config.llm.facts.is_model
    why = "which cannot draw a network at random: llm=grammar can"
    _check_that(draws, "proposals.parents", f"another one with llm={provider}, {why}", parents)
    why = f"with proposals.parents={parents}, whose requests have no parent"
    tells = config.prompts.tells
    _check_that(has_parents or not tells, "prompts.tells", f"[] {why}", tells)
    once = not {Tell.fitness, Tell.shuffled} <= {*tells}
    _check_that(once, "prompts.tells", "fitness, or its control shuffled, and not both", tells)
    whole = has_parents or config.prompts.answer is AnswerForm.whole
    _check_that(whole, "prompts.answer", f"whole {why}", config.prompts.answer)
    counts = not constant(config, PARENTS, "counts_elites") or constant(config, ARCHIVES, "has_niches")
    why = "which has no niches to count elites in"
    _check_that(counts, "proposals.parents", f"another one with archive.kind={kind}, {why}", parents)
