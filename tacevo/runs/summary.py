"""What a run found, in words and tables, from its ledger alone."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from tacevo.choices import ArchiveKind
from tacevo.costs import Spending, in_words, total, usd
from tacevo.records import Json, Operator, Stage
from tacevo.rules import eras_in_words, eras_of
from tacevo.search.unsent import TEMPERATURE, dropped_settings, not_sent
from tacevo.text import misreported, table

#: How many elites the summary lists.
TOP = 5


def summarise(
    run: Mapping[str, Json],
    lines: Sequence[Mapping[str, Json]],
    elites: Sequence[str],
    spent: Mapping[str, Spending],
) -> str:
    """Write the summary of a run as Markdown.

    Args:
        run: what run.json holds.
        lines: the ledger.
        elites: ids of the network archive's elites.
        spent: what each candidate's answers cost, by id, as far as that is known.

    Returns:
        A page with the search's size, its best networks, a table of the gate's stages, one of generations, and the
        cost of the answers.
    """
    candidates = {line["id"]: line for line in lines if line["kind"] == "candidate"}
    generations = [line for line in lines if line["kind"] == "generation"]
    parts = [f"# {run['name']}", _headline(run, candidates, generations), *_rules(lines)]
    parts += _not_sent(candidates.values())
    if generations and elites:
        parts += [_found(candidates, elites), _stages(candidates.values()), *_repaired(candidates.values())]
        parts += _unpromised(candidates.values())
        parts += [_progress(generations, run["config"]["archive"]), *_costs(candidates, generations, spent)]
    return "\n\n".join(parts) + "\n"


def _headline(
    run: Mapping[str, Json], candidates: Mapping[str, Mapping[str, Json]], generations: Sequence[Mapping[str, Json]]
) -> str:
    config, data = run["config"], run["data"]
    train, validation, test = data["counts"]
    size = data["image_size"]
    return (
        f"Task {run['task']['name']}, seed {config['seed']}, requests answered by {config['llm']['model']}, "
        f"{config['numerics']['kind']} numerics. {len(candidates)} candidates in {len(generations)} generations "
        f"(the first is generation 0). Data {data['fingerprint'][:12]}: {train} training, {validation} validation and "
        f"{test} test images of {size} x {size} pixels; the test images play no part in a search."
    )


def _rules(lines: Sequence[Mapping[str, Json]]) -> list[str]:
    """Say from which generation on other rules hold, where a run was continued under others."""
    eras = eras_of(lines) if lines else ()
    return [f"Made under more than one set of rules: {eras_in_words(eras)}."] if len(eras) > 1 else []


def _not_sent(lines: Collection[Mapping[str, Json]]) -> list[str]:
    """Say which sampling settings the model refuses, where it refuses any, and what that makes of T."""
    said = not_sent([dropped_settings(line) for line in lines if line["operator"] != Operator.baseline])
    planned = ["T, and the temperatures of the prompt archive, are what was planned."] if TEMPERATURE in said else []
    return [" ".join([*(f"{words}." for words in said.values()), *planned])] if said else []


def _found(candidates: Mapping[str, Mapping[str, Json]], elites: Sequence[str]) -> str:
    """Set the best elites beside the baseline and the best of generation 0."""
    baseline = next(line for line in candidates.values() if line["operator"] == "baseline")
    first = min(line["fitness"] for line in candidates.values() if line["generation"] == 0 and "fitness" in line)
    ranked = sorted((candidates[name] for name in elites), key=lambda line: (line["fitness"], line["id"]))
    rows = [
        [line["id"], _number(line["fitness"]), f"{line['parameters']:,}", f"{line['flops']:,}",
         _number(line["arch_div"]), _number(line["eff_ratio"]), line["operator"]]
        for line in [*ranked[:TOP], *([] if baseline in ranked[:TOP] else [baseline])]
    ]  # fmt: skip
    best = ranked[0]["fitness"]
    return (
        f"## Found\n\nBest fitness {_number(best)} by {ranked[0]['id']}: {_improvement(best, first)} than the best of "
        f"generation 0 ({_number(first)}) and {_improvement(best, baseline['fitness'])} than the baseline "
        f"({_number(baseline['fitness'])}). Fitness is the validation loss after the short training; lower wins.\n\n"
        + table(["elite", "fitness", "parameters", "FLOPs", "ArchDiv", "EffRatio", "operator"], rows)
    )


def _stages(lines: Collection[Mapping[str, Json]]) -> str:
    """Count where first answers were rejected, corrected or not; what is left at the end is the paper's rate.

    The baseline is not an answer, so it is not counted, as in `analysis.runs.dynamics.gate_stages`.
    """
    answers = [_first(line) for line in lines if line["operator"] != "baseline"]
    left = len(answers)
    reasons = Counter((first["stage"], first["reason"]) for first in answers if "stage" in first)
    rows = []
    for stage in Stage:
        lost = {reason: count for (where, reason), count in sorted(reasons.items()) if where == stage.value}
        left -= sum(lost.values())
        detail = ", ".join(f"{reason} {count}" for reason, count in lost.items()) or "-"
        rows.append(
            [stage.value, str(sum(lost.values())), str(left), f"{left / len(answers):.1%}" if answers else "-", detail]
        )
    page = "## Gate\n\nOf first answers; the baseline is not an answer.\n\n" + table(
        ["stage", "rejected", "left", "of all", "reasons"], rows
    )
    return "\n\n".join([page, *misreported((reason, count) for (_, reason), count in reasons.items())])


def _first(line: Mapping[str, Json]) -> Mapping[str, Json]:
    """Give what became of a candidate's first answer."""
    first: Mapping[str, Json] = line["repairs"][0] if "repairs" in line else line
    return first


def _repaired(lines: Collection[Mapping[str, Json]]) -> list[str]:
    """Say what came of the answers that were sent back, where any was."""
    sent_back = [line for line in lines if "repairs" in line]
    if not sent_back:
        return []
    attempts = sum(len(line["repairs"]) for line in sent_back)
    admitted = sum("source" in line for line in sent_back)
    trained = sum("fitness" in line for line in sent_back)
    return [
        f"Repaired: {len(sent_back)} answers were sent back, {attempts} times in all; {admitted} then passed the gate, "
        f"and {trained} of these trained. The table above counts them as rejected, where their first answer was."
    ]


def _unpromised(lines: Collection[Mapping[str, Json]]) -> list[str]:
    """Name the candidates whose training need not come again bit by bit, and what they use, where there are such."""
    kinds = {
        "not_portable": "Bits depend on the CPU, even under portable numerics",
        "not_deterministic": "Bits may differ from one training to the next, for want of a deterministic form",
    }
    found = {
        words: [f"{line['id']} ({', '.join(line[kind])})" for line in lines if kind in line]
        for kind, words in kinds.items()
    }
    return [f"{words} (docs/determinism.md): {', '.join(names)}." for words, names in found.items() if names]


def _costs(
    candidates: Mapping[str, Mapping[str, Json]],
    generations: Sequence[Mapping[str, Json]],
    spent: Mapping[str, Spending],
) -> list[str]:
    """Add up what the answers cost when they were recorded, generation by generation."""
    known = {name: spent[name] for name in candidates if name in spent}
    run = total(known.values())
    if not run.answers:
        return []
    rows = []
    for line in generations:
        number = line["generation"]
        part = total(known[name] for name in known if candidates[name]["generation"] == number)
        rows.append([str(number), str(part.answers), f"{part.input_tokens:,}", f"{part.output_tokens:,}", usd(part)])
    header = ["generation", "answers", "input tokens", "output tokens", "cost"]
    asked = sum(line["operator"] != "baseline" for line in candidates.values())
    missing = asked - sum(part.answers > 0 for part in known.values())
    gap = f" The cost of {missing} candidates is not in timings.jsonl." if missing else ""
    whole = f"{in_words(run)} (input + output), by the prices of the day each was recorded.{gap}"
    return [f"## Cost\n\n{whole}\n\n{table(header, rows)}"]


def _progress(generations: Sequence[Mapping[str, Json]], archive: Mapping[str, Json]) -> str:
    rows = [
        [str(line["generation"]), _trained(line), _number(line["best"]),
         _number(line["generation_median"]), f"{line['coverage']:.0%}", f"{line['prompt_coverage']:.0%}",
         f"{line['qd_score']:.3f}", f"{line['temperature']:.2f}"]
        for line in generations
    ]  # fmt: skip
    header = ["generation", "trained", "best", "median", "networks", "prompts", "QD-score", "T"]
    words = (
        "`trained` is of all slots; in generation 0 the baseline has one of them. `networks` and `prompts` are the "
        "coverage of the two archives."
    )
    if archive.get("kind") == ArchiveKind.best:
        words += f" That of networks has no niches, but places for the best {archive['kept']}."
    return f"## Generations\n\n{words}\n\n{table(header, rows)}"


def _trained(line: Mapping[str, Json]) -> str:
    """Write how many candidates of a generation trained, with those after a repair apart."""
    repaired = f" + {line['repaired']} repaired" if "repaired" in line else ""
    return f"{line['trained']}/{line['candidates']}{repaired}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _improvement(value: float, reference: float) -> str:
    """Say how much lower a loss is than another, in per cent of the other."""
    change = (reference - value) / reference if reference else 0.0
    return f"{change:.1%} lower" if change >= 0 else f"{-change:.1%} higher"
