"""What is proposed: by a language model and by the grammar, by arms of an ablation, by words, and by parents."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from analysis.statistics.tests import holm
from benchmarks.found.bundles import sweep
from benchmarks.found.estimates import AFTERWARDS, OUTCOME, PLANNED, Estimate, ratio
from benchmarks.found.records import ARMS, BASELINE

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

#: The arm of pairs in which nothing is told, and that of children of first mutations.
UNTOLD, PARENTS = "prompts.tells=[]", "search.networks=[parents]"


def _quartiles(name: str) -> pd.DataFrame:
    """Return the logarithms of the losses that a quarter of the proposals reach: a row a seed, a column an arm."""
    return np.log(sweep(name).jobs.pivot_table(index="seed", columns="arm", values="new_quartile"))


def claude_or_grammar() -> Estimate:
    """Return how Claude's proposals compare with the grammar's."""
    logs = _quartiles("claude-vs-grammar")
    known = {"unit": "seeds", "bundle": "claude-vs-grammar", "fixed": OUTCOME}
    return ratio("Claude / grammar", logs["none"] - logs["llm_vs_grammar"], **known)


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
        yield replace(row, beside=f"{tests.p_holm[arm]:.2g}")


def ablation_written() -> Iterator[Estimate]:
    """Yield the planned test of each arm, and the test of pairs, which is another one."""
    logs = _quartiles("ablation-proposals")
    tests = sweep("ablation-proposals").contrasts("new_quartile")
    paired = [float(wilcoxon(logs[arm] - logs["none"]).pvalue) for arm in NAMES]
    for (arm, name), p, corrected in zip(NAMES.items(), paired, holm(paired), strict=True):
        known = {"bundle": "ablation-proposals", "count": len(logs), "unit": "searches an arm"}
        p_holm = float(tests.p_holm[arm])
        yield Estimate(of=f"{name}: p after Holm, Mann-Whitney", value=p_holm, form="{:.2g}", fixed=PLANNED, **known)
        of = {"p of pairs, Wilcoxon": p, "p of pairs after Holm, Wilcoxon": corrected}
        for what, value in of.items():
            yield Estimate(of=f"{name}: {what}", value=value, form="{:.2g}", fixed=AFTERWARDS, **known)
        ends = tests.by_seed_low[arm], tests.by_seed_high[arm]
        yield Estimate(
            of=f"{name}: median difference by seed",
            value=tests.by_seed[arm],
            ends=ends,
            form="{:.3f}",
            fixed=AFTERWARDS,
            **known,
        )


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
                beside=f"{one.operations_p_holm:.2g}",
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
    ends = row.factor_low, row.factor_high
    known = {"count": int(row.questions), "unit": "questions", "bundle": bundle, "fixed": PLANNED}
    return Estimate(of=of, value=row.factor, ends=ends, **known)


def children() -> Estimate:
    """Return the loss of children of elites as a multiple of that of children of first mutations."""
    arms = sweep("operator-or-search").pairs(PARENTS, other_parents=True).arms
    row = arms.loc["search.networks=[selected]"]
    return _factor("children: of elites / of first mutations", row, bundle="operator-or-search")


def operator_drawn() -> Iterator[Estimate]:
    """Yield how parents compare, how their children do, and each child with its parent."""
    asked = _asked()
    by_question = asked.drop(columns="parent").groupby("question").mean()
    known = {"unit": "questions", "bundle": "operator-or-search"}
    parents = by_question.selected_parent - by_question.parents_parent
    yield ratio("parents: elites / first mutations", parents, fixed=AFTERWARDS, **known)
    yield children()
    gained = by_question.selected - by_question.parents - parents
    yield ratio("second ratio / first ratio", gained, fixed=AFTERWARDS, **known)
    of_first = by_question.parents - by_question.parents_parent
    yield ratio("child of a first mutation / its parent", of_first, fixed=OUTCOME, **known)
    of_elites = by_question.selected - by_question.selected_parent
    yield ratio("child of an elite / its parent", of_elites, fixed=OUTCOME, **known)


def operator_written() -> Iterator[Estimate]:
    """Yield the children that have their parent's very loss, and the children's ratio otherwise counted."""
    asked = _asked()
    known = {"bundle": "operator-or-search", "fixed": AFTERWARDS}
    equal = {arm: asked[arm] == asked[f"{arm}_parent"] for arm in ("selected", "parents")}
    for arm, of in (("selected", "elites"), ("parents", "first mutations")):
        losses = _children(arm)
        same = int((losses.loss == losses.parent_loss).sum())
        of_all = {"count": len(losses), "unit": "children", "form": f"{{:.0f}} of {len(losses)}"}
        yield Estimate(of=f"children of {of} with exactly their parent's loss", value=same, **of_all, **known)
    logs = asked.selected - asked.parents
    of = "children: of elites / of first mutations"
    yield ratio(f"{of}, by the parent's place", logs.groupby(asked.parent).mean(), unit="places of parents", **known)
    others = logs[~(equal["selected"] | equal["parents"])]
    others = others.groupby(asked.question[others.index]).mean()
    yield ratio(f"{of}, without children that have their parent's loss", others, unit="questions", **known)


def _children(arm: str) -> pd.DataFrame:
    """Return the children of an arm by slot: question, parent's place, and the logarithms of both losses."""
    compared = sweep("operator-or-search")
    (job,) = compared.jobs.index[compared.jobs.arm == f"search.networks=[{arm}]"]
    candidates = compared.run(str(job)).candidates
    losses = np.log(candidates.fitness)
    own = candidates[candidates.generation == 1].set_index("slot", drop=False)
    parent = own.parents.map(lambda parents: parents[0])
    question = parent + ": " + own.instruction.astype(str)
    of_parent = losses[parent].to_numpy()
    logs = losses[candidates.generation == 1].to_numpy()
    return pd.DataFrame({"question": question, "parent": parent, "loss": logs, "parent_loss": of_parent})


def _asked() -> pd.DataFrame:
    """Return by slot what both arms answered to one question: logarithms of losses of children and parents."""
    first, elites = _children("parents"), _children("selected")
    both = first.join(elites, rsuffix="_of_elites", how="inner")
    both = both[(both.question == both.question_of_elites) & (both.parent != BASELINE)]  # of it both were asked the same
    names = {"loss": "parents", "parent_loss": "parents_parent"}
    names |= {"loss_of_elites": "selected", "parent_loss_of_elites": "selected_parent"}
    return both.rename(columns=names)[["question", "parent", *names.values()]]
