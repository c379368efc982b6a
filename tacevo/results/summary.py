"""The findings of a run in words and tables: for summary.md, the end of a search and the page.

It follows from the ledger; of candidates that are alike in all that it says, also from their texts.
"""

import math
from collections.abc import Callable, Collection, Mapping

from tacevo.config.recorded_parts import brought, constant, own_axes
from tacevo.config.schema import RunConfig
from tacevo.costs import in_words, total
from tacevo.evolution.lines import (
    TEMPERATURE,
    CandidateLine,
    GateStage,
    GenerationLine,
    gate_stages,
    misreported,
    skipped_note,
)
from tacevo.parts.kinds import ARCHIVES
from tacevo.records import Json
from tacevo.results.grouped import in_groups
from tacevo.results.run import RecordedRun
from tacevo.rounding import significant
from tacevo.text import assignments, counted, in_markdown, listed, table

#: The meaning of the trivial loss, in words.
TRIVIAL = "the least that the same answer to every validation image can have"

#: The number of elites that the summary lists.
TOP = 5


def summarise(run: RecordedRun) -> str:
    """Write the summary of a run as Markdown: what fits one screen, what it rests on, and a table of generations.

    The run may have been stopped anywhere; its elites are those of the last archive that was written.
    """
    prose = [data_in_words(run), *_unpromised(run.candidates), *_eager(run.candidates)]
    parts = [f"# {in_markdown(run.record.name)}", *_short(run, in_markdown), *map(in_markdown, prose)]
    return "\n\n".join([*parts, *([_progress(run)] if run.generations else [])]) + "\n"


def in_short(run: RecordedRun) -> str:
    """Return what fits one screen, for a terminal; where nothing was found it begins with that."""
    return "\n\n".join(_short(run, str)) + "\n"


def _short(run: RecordedRun, write: Callable[[str], str]) -> list[str]:
    """Return paragraphs, each line of them written by `write`, and the table of elites."""
    fitness, elites = outcome_in_words(run)
    prose = [searched(run), _brought(run), _not_sent(run)]
    if not fitness:
        return [write(words) for words in prose if words]
    above = [write(words) for words in [*prose, run.shortfall, fitness] if words]
    return [*above, elites, "\n".join(map(write, rates_in_words(run)))]


#: The part of a training that a fitness is, by its rule; `{}` stands for the kind of seed.
_LOSSES = {
    "last": "loss of one {} seed",
    "lowest": "lowest loss of one seed",
    "mean_of_3": "mean of 3 losses of one seed",
}


def is_looked_up(config: RunConfig) -> bool:
    """Answer whether a run trains nothing, and looks its evaluations up in the table of a space."""
    return config.data.facts.is_looked_up


def evaluated(config: RunConfig) -> str:
    """Return the word for a network that has a fitness: trained, or looked up in a table."""
    return "looked up" if is_looked_up(config) else "trained"


def worth(config: RunConfig) -> str:
    """Say what a fitness is, and what the best is not, as `one draw, the loss of one training seed, and ...`."""
    fitness = config.training.fitness
    loss = _LOSSES.get(fitness, f"{fitness} of the losses of one {{}} seed").format(
        "recorded" if is_looked_up(config) else "training"
    )
    return f"one draw, the {loss}, and the best is the lowest of many."


def searched(run: RecordedRun) -> str:
    """Say the task, the seed, what answered, and the size."""
    unasked = run.generations and not run.answered
    answers = "no model was asked" if unasked else f"requests answered by {run.model}"
    return (
        f"Task {run.record.task.name}, seed {run.config.seed}, {answers}, "
        f"{run.config.numerics.kind} numerics. {counted(len(run.candidates), 'candidate')} in "
        f"{counted(len(run.generations), 'generation')} (the first is generation 0)."
    )


def _brought(run: RecordedRun) -> str:
    """Name the parts that decided and that the user brought, with their settings; empty where there are none."""
    parts = [
        f"{kind.setting}={name}{_settings_in_words(run.config.parts.get(name, {}))}"
        for kind, name in brought(run.config)
    ]
    return f"Parts of its user's that decided: {listed(parts)}." if parts else ""


def _settings_in_words(settings: Mapping[str, Json]) -> str:
    return f" ({listed(assignments([*settings.items()]))})" if settings else ""


def data_in_words(run: RecordedRun) -> str:
    """Say what the images are, and their trivial loss."""
    facts, trivial = run.record.data, run.record.trivial
    train, validation, test = facts.counts
    return (
        f"Data {facts.fingerprint[:12]}: {train} training, {validation} validation and {test} test images"
        f"{in_groups(facts)} of {facts.image_size} x {facts.image_size} pixels; the test images play no part in a "
        "search." + ("" if trivial is None else f" The trivial loss, {TRIVIAL}: {_number(trivial)}.")
    )


def _not_sent(run: RecordedRun) -> str:
    """Say what carries T, which sampling settings were not sent, and what that makes of T."""
    carried = [run.carrier_note] if run.carrier_note else []
    planned = ["T, and the temperatures of the prompt archive, are what was planned."]
    unsent = [*(f"{words}." for words in run.not_sent.values()), *(planned if TEMPERATURE in run.not_sent else [])]
    return " ".join([*carried, *unsent])


def outcome_in_words(run: RecordedRun) -> tuple[str, str]:
    """Return the lowest fitness beside the baseline's and the best of generation 0, and the best elites as a table.

    It is called the best only where it is one. Both are empty before a generation is complete, and without any elite.
    """
    candidates = {line.id: line for line in run.candidates}
    ranked = sorted((candidates[elite.id] for elite in run.elites), key=lambda line: (_fitness(line), line.id))
    if not ranked:
        return "", ""
    baseline = candidates[run.baseline.id]
    first = min((_fitness(line) for line in run.trained if line.generation == 0), default=None)
    rows = [
        [in_markdown(line.id), _number(line.fitness), f"{line.parameters:,}", f"{line.flops:,}",
         _number(line.arch_div), _number(line.eff_ratio), *map(_number, line.measures), line.operator]
        for line in [*ranked[:TOP], *([] if baseline in ranked[:TOP] else [baseline])]
    ]  # fmt: skip
    trivial = "" if run.record.trivial is None else f"; the trivial loss is {_number(run.record.trivial)}"
    words = (
        f"fitness {_number(ranked[0].fitness)} by {ranked[0].id}; the best of generation 0 has {_number(first)}, "
        f"the baseline {_number(baseline.fitness)}{trivial}."
    )
    best = f"Best {words} {_fitness_in_words(run)}; lower wins. Each is {worth(run.config)}"
    own = map(in_markdown, own_axes(run.config))
    header = ["elite", "fitness", "parameters", "FLOPs", "ArchDiv", "EffRatio", *own, "operator"]
    return f"Lowest {words}" if run.shortfall else best, table(header, rows)


def _fitness_in_words(run: RecordedRun) -> str:
    """Say what loss a fitness is."""
    if not is_looked_up(run.config):
        return "Fitness is a validation loss of the short training"
    epochs = counted(run.config.training.epochs, "epoch")
    return (
        f"Each fitness was looked up in the table {run.record.data.fingerprint[:12]}: a validation loss of the first "
        f"{epochs} that stand there"
    )


def _fitness(line: CandidateLine) -> float:
    return math.nan if line.fitness is None else line.fitness


def rates_in_words(run: RecordedRun) -> list[str]:
    """Say how many first answers the gate let through, where others ended, what came of second ones, and the cost.

    The share that is left is the paper's rate.
    """
    lines = run.candidates
    stages = gate_stages(lines)
    left, share = stages[-1].left, stages[-1].left_share
    if share is None:
        return ["Gate: no model was asked.", *_cost(run)]
    answers = counted(left + sum(one.rejected for one in stages), "first answer")
    rejected = listed(f"{one.stage} {one.rejected} ({_reasons(one)})" for one in stages if one.rejected)
    did = evaluated(run.config)
    skipped = skipped_note(lines, did)
    what = f"{did} or skipped" if skipped else did
    rate = f"Gate: {left} of {answers} {what} ({_percent(share)}); rejected: {rejected}."
    said = [*_unchanged(run), *skipped, *misreported(stages), *_repaired(lines, did), *_by_model(run, did)]
    return [rate, *said, *_cost(run)]


def _unchanged(run: RecordedRun) -> list[str]:
    """Say how many candidates are a parent's network again, which the rate counts as any other, where one is."""
    count = sum(run.directory.read_kept(name) is not None for name in run.copies)  # whose text a reader can compare
    return [f"Unchanged: {counted(count, 'answer')} with the network of a parent again, words aside."] if count else []


def _reasons(stage: GateStage) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in sorted(stage.reasons))


def _repaired(lines: Collection[CandidateLine], did: str) -> list[str]:
    """Say what came of the answers that were sent back, where any was; `did` is `trained`, or `looked up`."""
    sent_back = [line for line in lines if line.repairs]
    if not sent_back:
        return []
    attempts = sum(len(line.repairs) for line in sent_back)
    admitted = sum(line.source is not None for line in sent_back)
    known = sum(line.fitness is not None for line in sent_back)
    of_these = f"{known} of these {did}" if did == "trained" else f"{known} of these were {did}"
    return [
        f"Repaired: {len(sent_back)} answers were sent back, {attempts} times in all; {admitted} then passed the gate, "
        f"and {of_these}. They count as rejected above, where their first answer was."
    ]


def _by_model(run: RecordedRun, did: str) -> list[str]:
    """Say what came of the answers of each model, in a search with several; `did` is `trained`, or `looked up`."""
    if run.config.llm.models is None:
        return []
    parts = []
    for name in run.config.llm.names:
        lines = [line for line in run.answered if line.model == name]
        trained, inserted = sum(line.fitness is not None for line in lines), sum(line.inserted for line in lines)
        parts.append(f"{name} {len(lines)} asked, {trained} {did}, {inserted} inserted")
    return [f"Models: {'; '.join(parts)}."]


def _unpromised(lines: Collection[CandidateLine]) -> list[str]:
    """Name the candidates whose training need not come again bit by bit, and what they use, where there are such."""
    uses = {
        "Bits depend on the CPU, even under portable numerics": {
            line.id: line.not_portable for line in lines if not line.skipped
        },
        "Bits may differ from one training to the next, where an operation has no deterministic form": {
            line.id: tuple(sorted(set(line.not_deterministic))) for line in lines
        },
    }
    named = {
        words: [f"{id} ({', '.join(used)})" for id, used in by_id.items() if used] for words, by_id in uses.items()
    }
    return [f"{words} (docs/determinism.md): {', '.join(names)}." for words, names in named.items() if names]


def _eager(lines: Collection[CandidateLine]) -> list[str]:
    """Name the candidates whose steps could not be recorded on a GPU, where that was asked for."""
    trained = [(line.id, line.captured) for line in lines if line.captured is not None]
    eager = dict.fromkeys(id for id, captured in trained if not captured)
    if not trained:
        return []
    words = f"Trained step by step, since one step could not be recorded for all (docs/scale.md): {', '.join(eager)}."
    return [words if eager else "The step of every training was recorded once and replayed (docs/scale.md)."]


def _cost(run: RecordedRun) -> list[str]:
    """Say in a line what the answers cost when they were recorded; nothing where they were free."""
    known = [run.spent[line.id] for line in run.candidates if line.id in run.spent]
    spent = total(known)
    missing = len(run.answered) - sum(part.answers > 0 for part in known)
    gap = f" That of {counted(missing, 'candidate')} is not in timings.jsonl." if missing else ""
    return [f"Cost: {in_words(spent)}.{gap}"] if spent.usd or spent.unpriced else []


def _progress(run: RecordedRun) -> str:
    rows = [
        [str(line.generation), _trained(line), _number(line.best),
         _number(line.generation_median), _percent(line.coverage), _percent(line.prompt_coverage),
         _number(line.qd_score), _number(line.temperature)]
        for line in run.generations
    ]  # fmt: skip
    config, did = run.config, evaluated(run.config)
    header = ["generation", did, "best", "median", "networks", "prompts", "QD-score", f"T{run.carried}"]
    words = (
        f"`{did}` is of all slots; in generation 0 the baseline has one of them. `networks` and `prompts` are the "
        "coverage of the two archives."
    )
    if not constant(config, ARCHIVES, "has_niches"):
        words += f" That of networks has no niches, but places for the best {config.archive.kept}."
    if config.search.training_flops is not None:
        counts = "what it looks up reaches" if is_looked_up(config) else "its trainings reach"
        words += f" The search ends where {counts} search.training_flops={config.search.training_flops:g}."
    return f"## Generations\n\n{words}\n\n{table(header, rows)}"


def _trained(line: GenerationLine) -> str:
    """Write how many candidates of a generation trained, with those after a repair apart."""
    repaired = "" if line.repaired is None else f" + {line.repaired} repaired"
    skipped = "" if line.skipped is None else f" ({line.skipped} skipped)"
    return f"{line.trained}/{line.candidates}{repaired}{skipped}"


def _number(value: float | None) -> str:
    return "-" if value is None else significant(value)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
