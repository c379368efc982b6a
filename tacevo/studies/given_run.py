"""Given networks, recorded as a run: generation 0 is the baseline and these, each past the gate and trained once.

So whatever is made of a run is made of them: replays, studies, tables, figures, reports and bundles.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.records import Given, Mode
from tacevo.runs.datasets import load_data
from tacevo.runs.given_networks import admitted_networks
from tacevo.runs.progress import Progress
from tacevo.runs.providers import build_llm
from tacevo.runs.session import check_needed, record
from tacevo.runs.wiring import started_ahead
from tacevo.text import counted


def record_given(config: RunConfig, files: Mapping[Path, Given], view: Progress) -> Path:
    """Record given networks as a run, or find the one that was recorded under the same configuration.

    Returns:
        The directory of the run.

    Raises:
        ConfigError: the gate rejects a file, or would take a part of it only, or a training of it fails; two files hold
            one network.
        TacevoError: as `tacevo.runs.session.search`; what was computed so far is kept.
    """
    check_needed(config)
    llm = build_llm(config, Mode.replay)  # nothing is asked, so the provider may be missing
    with started_ahead(config) as started:
        data = load_data(config, view)
        task = load_task(config, data.facts)
        given = admitted_networks(config, task, data, files)
        epochs = config.training.epochs
        view.say(
            f"the run trains each of {counted(len(given) + 1, 'network')} for {counted(epochs, 'epoch')} first, as a "
            f"search does, unless that is recorded (training.epochs={epochs}); the study trains them anew"
        )
        return record(config, replace(task, given=given), data, view, started=started, llm=llm).directory
