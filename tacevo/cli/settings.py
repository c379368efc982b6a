"""The settings of commands, as their help lists them."""

import textwrap
from collections.abc import Iterable
from dataclasses import asdict

from tacevo.cli.signature import WIDTH

#: What may be set of a study, and what it means; conf/study.yaml has the defaults.
STUDY = {
    "run": "the same as RUN alone: the directory of a finished run, whose networks are studied; or",
    "sweep": "that of a sweep: a study of each finished job, with its best elite; or",
    "networks": "files of networks, directories and patterns of such; none for the baseline of task= alone",
    "arms": "those of sweep= whose jobs are studied, as in arms=none,drift (all)",
    "elites": "how many elites of run=, best first, beside the baseline (4)",
    "choose": "best by: fitness (recorded), or reestimated (by `tacevo noise`); or validated: of elites= one, by a "
    "training of each with a seed of its own; the first unless set",
    "seeds": "training seeds of each network (20)",
    "epochs": "of each training; the weights of the best validation epoch are tested (50)",
    "seconds": "the longest time of one training (86400)",
    "memory_mib": "the most memory of one training (4096)",
    "alpha": "level of the tests, after Holm (0.05)",
    "margins.regression.value": "the largest difference of the test MSE that counts as none (0.1)",
    "margins.regression.kind": "relative (to the baseline's median), or absolute; the first unless set",
    "margins.classification.value": "the same for the test accuracy (0.01)",
    "margins.classification.kind": "absolute (in the metric itself), or relative; the first unless set",
    "plan": "the plan.json that it follows, which is kept in it (none)",
    "executor": "local or ray: on this machine, or on the nodes of a Ray cluster; the first unless set",
    "executor.workers": "trainings at once (2)",
    "executor.per_gpu": "with a GPU: most trainings on it at once (as many as fit)",
    "executor.address": "of that cluster, as HOST:PORT or auto; none starts a Ray here",
    "store.root": "the directory of the stores (that of the run)",
}

#: The same of a noise run; conf/noise.yaml has the defaults.
NOISE = {
    "run": "the same as RUN alone: the directory of a finished run; or",
    "sweep": "that of a sweep: a noise run of each finished job",
    "elites": "how many elites, best validation loss first, beside the baseline (all)",
    "seeds": "training seeds of each network (5)",
    **{key: STUDY[key] for key in ("executor", "executor.workers", "executor.per_gpu", "executor.address")},
    "store.root": STUDY["store.root"],
}


def of_study() -> str:
    """List the settings of a study."""
    return _listed(STUDY)


def of_noise() -> str:
    """List the settings of a noise run."""
    return _listed(NOISE)


def _listed(settings: dict[str, str]) -> str:
    return "\n".join(["settings, with their defaults:", *_beside(settings.items())])


def _beside(pairs: Iterable[tuple[str, str]]) -> Iterable[str]:
    """Write names with their meanings beside them, or below where a name is long, in the width of a help."""
    meanings = dict(pairs)
    place = 4 + min(max(map(len, meanings)), 28)
    for name, meaning in meanings.items():
        lines = textwrap.wrap(meaning, WIDTH - place, break_on_hyphens=False) or [""]
        first = f"  {name}"
        if len(first) + 2 <= place:
            yield f"{first.ljust(place)}{lines.pop(0)}".rstrip()
        else:
            yield first
        yield from (f"{' ' * place}{line}" for line in lines)


def of_search() -> str:
    """List the choices of every config group, and every setting as it is where no group and no setting is given."""
    from tacevo.config.comments import comments
    from tacevo.config.compose import compose  # half a second, which only this help needs
    from tacevo.config.conf_folder import groups
    from tacevo.storage.canonical import canonical, leaves

    choices, words = groups(), comments()
    defaults = [
        (key, value if isinstance(value, str) else canonical(value))
        for key, value in leaves(asdict(compose([])))
        if key not in {"parts", "code"}  # of parts of a user's own, which nobody has by default
    ]
    return "\n".join(
        [
            "config groups and their choices:",
            *_beside((name, ", ".join(names)) for name, names in choices.items()),
            "",
            "settings, with their defaults (choices may change them):",
            *_beside((f"{key}={value}", words[key].partition(". ")[0].rstrip(".")) for key, value in defaults),
        ]
    )
