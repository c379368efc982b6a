"""What is proposed: by a language model and by the grammar, by arms of an ablation, by words, and by parents."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from analysis.statistics.tests import holm
from benchmarks.found.bundles import sweep
from benchmarks.found.estimates import AFTERWARDS, OUTCOME, PLANNED, Estimate, ratio
from benchmarks.found.records import ARMS, BASELINE
from tacevo.rounding import significant

#: The arms of the ablation by proposals, by what they are.
NAMES = {
    "fixed_temperature_0": "temperature always 0",
    "fixed_temperature_1": "temperature always 1",
    "effect_prompts": "prompts by their effect",
    "drift": ARMS["drift"],
    "best_k": "best k of all, no niches (best_k)",
}

#: What the words of a temperature are, by its number, and which of them the others are compared with.
SENTENCES = {"0.1": "change one thing", "0.5": "the third sentence", "0.9": "depart boldly"}

#: Below it a p is called a difference, and other tests of the same arm are listed, too.
LEVEL = 0.05

#: The arm of pairs in which nothing is told, and that of children of first mutations.
UNTOLD, PARENTS = "prompts.tells=[]", "search.networks=[parents]"


def _quartiles(name: str) -> pd.DataFrame:
    """Return the logarithms of the losses that a quarter of the proposals reach: a row a seed, a column an arm."""
    return np.log(sweep(name).jobs.pivot_table(index="seed", columns="arm", values="new_quartile"))


def claude_or_grammar() -> Estimate:
    """Return how Claude's proposals compare with the grammar's."""
    logs = _quartiles("claude-vs-grammar")
    apart = logs["none"] - logs["llm_vs_grammar"]
    return ratio("Claude / grammar", apart, unit="seeds", bundle="claude-vs-grammar", fixed=OUTCOME)


def model_drawn() -> Iterator[Estimate]:
    """Yield what a quarter of the proposals of each search reaches."""
    jobs = sweep("claude-vs-grammar").jobs
    for arm, name in {"none": "Claude", "llm_vs_grammar": "grammar"}.items():
        for job in jobs[jobs.arm == arm].itertuples():
            yield Estimate(
                of=f"seed {job.seed}",
                value=job.new_quartile,
                count=1,
                unit="searches",
                bundle="claude-vs-grammar",
                fixed=PLANNED,
                form="{:.3f}",
                group=name,
            )


def model_written() -> Iterator[Estimate]:
    """Yield how the two compare."""
    yield claude_or_grammar()
    one = sweep("claude-vs-grammar").contrasts("new_quartile").loc["llm_vs_grammar"]
    yield Estimate(
        of="difference of medians, grammar - Claude",
        value=one.difference,
        ends=(one.difference_low, one.difference_high),
        interval="75 %",  # all that three searches a side allow: `tacevo ablations` prints it
        count=3,
        unit="searches a side",
        bundle="claude-vs-grammar",
        fixed=PLANNED,
        form="{:.3f}",
    )


def ablation_drawn() -> Iterator[Estimate]:
    """Yield the arms' proposals as multiples of those of the method, by seed."""
    logs = _quartiles("ablation-proposals")
    tests = sweep("ablation-proposals").contrasts("new_quartile")
    for arm, name in NAMES.items():
        row = ratio(name, logs[arm] - logs["none"], unit="seeds", bundle="ablation-proposals", fixed=OUTCOME)
        yield replace(row, beside=significant(float(tests.p_holm[arm]), 2))


def ablation_written() -> Iterator[Estimate]:
    """Yield the planned test of each arm, and the test of pairs, which is another one."""
    logs = _quartiles("ablation-proposals")
    tests = sweep("ablation-proposals").contrasts("new_quartile")
    paired = [float(wilcoxon(logs[arm] - logs["none"]).pvalue) for arm in NAMES]
    estimate = partial(Estimate, bundle="ablation-proposals", count=len(logs), unit="searches an arm")
    for (arm, name), p, corrected in zip(NAMES.items(), paired, holm(paired), strict=True):
        planned, of = float(tests.p_holm[arm]), f"{name}: p after Holm"
        yield estimate(of=f"{of}, Mann-Whitney", value=planned, form="{:.2g}", fixed=PLANNED)
        if planned < LEVEL:
            yield estimate(of=f"{name}: p of pairs, Wilcoxon", value=p, form="{:.2g}", fixed=AFTERWARDS)
            yield estimate(of=f"{of} of pairs, Wilcoxon", value=corrected, form="{:.2g}", fixed=AFTERWARDS)
            ends, of = (tests.by_seed_low[arm], tests.by_seed_high[arm]), f"{name}: median difference by seed"
            yield estimate(of=of, value=tests.by_seed[arm], ends=ends, form="{:.3f}", fixed=AFTERWARDS)


def words_drawn() -> Iterator[Estimate]:
    """Yield how much farther two answers to one question lie apart than with the first sentence."""
    for _, sentence, one in _apart():
        if not math.isnan(one.operations_difference):
            yield Estimate(
                of=sentence,
                value=one.operations_difference,
                ends=(one.operations_difference_low, one.operations_difference_high),
                count=int(one.questions),
                unit="questions",
                bundle="words-temperature",
                fixed=PLANNED,
                form="{:.3f}",
                beside=significant(one.operations_p_holm, 2),
            )


def words_written() -> Iterator[Estimate]:
    """Yield how far two answers to one question lie apart."""
    for _, sentence, one in _apart():
        yield Estimate(
            of=f"distance with {sentence!r}",
            value=one.operations,
            count=int(one.questions),
            unit="questions",
            bundle="words-temperature",
            fixed=PLANNED,
            form="{:.3f}",
        )


def _apart() -> Iterator[tuple[str, str, pd.Series]]:
    apart = sweep("words-temperature").pairs("temperature.start=0.1").diversity
    assert apart is not None
    for arm, one in apart.iterrows():
        number = str(arm).partition("=")[2]
        yield number, SENTENCES[number], one


def telling_drawn() -> Iterator[Estimate]:
    """Yield the loss of answers that were told losses as a multiple of that of answers that were not."""
    arms = sweep("telling-losses").pairs(UNTOLD).arms
    for arm, name in {"[fitness]": "told the parent's loss", "[shuffled]": "told another network's loss"}.items():
        row = arms.loc[f"prompts.tells={arm}"]
        yield _factor(name, row, bundle="telling-losses")


def _factor(of: str, row: pd.Series, *, bundle: str) -> Estimate:
    """Return the factor of an arm of pairs."""
    ends, questions = (row.factor_low, row.factor_high), int(row.questions)
    return Estimate(of=of, value=row.factor, ends=ends, count=questions, unit="questions", bundle=bundle, fixed=PLANNED)


def children() -> Estimate:
    """Return the loss of children of elites as a multiple of that of children of first mutations."""
    arms = sweep("operator-or-search").pairs(PARENTS, other_parents=True).arms
    row = arms.loc["search.networks=[selected]"]
    return _factor("children: of elites / of first mutations", row, bundle="operator-or-search")


def operator_drawn() -> Iterator[Estimate]:
    """Yield how parents compare, how their children do, and each child with its parent."""
    asked = _asked()
    logs = asked.drop(columns="parent").groupby("question").mean()
    estimate = partial(ratio, unit="questions", bundle="operator-or-search")
    parents = logs.elite - logs.mutation
    yield estimate("parents: elites / first mutations", parents, fixed=AFTERWARDS)
    yield children()
    gained = logs.child_of_elite - logs.child_of_mutation - parents
    yield estimate("children's ratio / parents' ratio", gained, fixed=AFTERWARDS)
    yield estimate("child of a first mutation / its parent", logs.child_of_mutation - logs.mutation, fixed=OUTCOME)
    yield estimate("child of an elite / its parent", logs.child_of_elite - logs.elite, fixed=OUTCOME)


def operator_written() -> Iterator[Estimate]:
    """Yield the children that have their parent's very loss, and the children's ratio otherwise counted."""
    estimate = partial(Estimate, bundle="operator-or-search", fixed=AFTERWARDS)
    for arm, of in (("selected", "elites"), ("parents", "first mutations")):
        born = _children(arm)
        same, form = int((born.loss == born.parent_loss).sum()), f"{{:.0f}} of {len(born)}"
        named = f"children of {of} with exactly their parent's loss"
        yield estimate(of=named, value=same, form=form, count=len(born), unit="children")
    asked = _asked()
    apart = asked.child_of_elite - asked.child_of_mutation
    again = partial(ratio, bundle="operator-or-search", fixed=AFTERWARDS)
    of = "children: of elites / of first mutations"
    yield again(f"{of}, by the parent's place", apart.groupby(asked.parent).mean(), unit="places of parents")
    is_copy = (asked.child_of_elite == asked.elite) | (asked.child_of_mutation == asked.mutation)
    yield again(f"{of}, without pairs in which a child has its parent's loss", apart[~is_copy], unit="pairs")


def _children(arm: str) -> pd.DataFrame:
    """Return the children of an arm by slot: question, the parent's place, and the logarithms of both losses."""
    compared = sweep("operator-or-search")
    (job,) = compared.jobs.index[compared.jobs.arm == f"search.networks=[{arm}]"]
    candidates = compared.run(str(job)).candidates
    losses = np.log(candidates.fitness)
    born = candidates[candidates.generation == 1]
    parent = born.parents.map(lambda parents: parents[0])
    found = {"parent": parent, "loss": losses[born.index], "parent_loss": losses[parent].to_numpy()}
    return pd.DataFrame({"question": parent + ": " + born.instruction.astype(str), **found}).set_index(born.slot)


def _asked() -> pd.DataFrame:
    """Return by slot what both arms answered to one question: logarithms of losses of children and parents.

    Of the baseline, a parent in both arms, they were asked the same, and have one answer.
    """
    both = _children("parents").join(_children("selected").add_suffix("_of_elite"), how="inner")
    both = both[(both.question == both.question_of_elite) & (both.parent != BASELINE)]
    names = {"loss": "child_of_mutation", "parent_loss": "mutation"}
    names |= {"loss_of_elite": "child_of_elite", "parent_loss_of_elite": "elite"}
    return both.rename(columns=names)[["question", "parent", *names.values()]]
