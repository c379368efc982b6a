"""The table of a space, verified: its rows follow from each other, and are measured and trained again, bit for bit."""

from dataclasses import replace
from itertools import zip_longest

from tacevo.choices import Confinement, Device
from tacevo.config.schema import ExecutorConfig, SandboxConfig, StoreConfig
from tacevo.data.loading import split_rows
from tacevo.environment import machine, usable_cores, versions
from tacevo.errors import BundleError, ConfigError, DataError, DivergenceError, SandboxError
from tacevo.parts.facts import HERE
from tacevo.records import DataFacts, Json, Mode, to_json
from tacevo.reproduce.retrain import BY_MACHINE, doubts_of, sampled
from tacevo.results.gene_model import put_first
from tacevo.results.space_table import card
from tacevo.results.table_header import HEADER
from tacevo.results.table_records import CARD, JUDGE, TRAININGS, SpaceTable, TableNetwork
from tacevo.rules import CURRENT, LIKE_TODAY, TRAININGS_OF_STUDIES, check_known
from tacevo.runs.datasets import load_same, source_of, trivial_of
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import judge_seed, training_seed
from tacevo.runs.wiring import Workbench, check_means
from tacevo.storage.canonical import canonical, differences
from tacevo.studies.tabulate import members, network_of
from tacevo.text import counted


def verify_table(table: SpaceTable) -> None:
    """Check that a table holds exactly the networks of its space, each genome with its source, its seeds and its card.

    Of simulated data also what follows from their settings: names, and images of each part.

    Raises:
        BundleError: it is damaged so that this cannot be compared.
        DivergenceError: the first network that is another one; or other seeds, other data, or another README.
    """
    config, header = table.header.settings, table.header
    if config.llm.space is None:
        raise BundleError("null", place=f"{table.path}, config.llm.space", expected="a closed space")
    try:
        expected = members(config, header.task)
    except ConfigError as error:
        place = f"{table.path}, table.json, {error.place}"
        raise BundleError(error.got, place=place, expected=error.expected) from error
    for row, (network, (genome, source)) in enumerate(zip(table.networks, expected, strict=False)):
        if (canonical(to_json(network.genome)), network.source) != (canonical(to_json(genome)), source):
            place = f"{table.path}, networks.jsonl, line {row + 1}"
            raise DivergenceError("another", place=place, expected=f"the network of the genome {genome}")
    if len(table.networks) != len(expected):
        got, space = counted(len(table.networks), "network"), f"{len(expected)}, those of its space"
        raise DivergenceError(got, place=str(table.path), expected=space)
    seeds = tuple(training_seed(config.seed, number) for number in range(len(header.seeds)))
    if header.seeds != seeds:
        place, said = f"{table.path}, seeds", f"{list(seeds)}, those that follow from seed {config.seed}"
        raise DivergenceError(f"{list(header.seeds)}", place=place, expected=said)
    if config.data.facts.is_made:
        _check_facts(table, _simulated(table))
    judge = table.judge
    if judge is not None:
        _check_judge(table, judge)
    if table.card != card(header, table.networks, None if judge is None else (judge.header, judge.trainings)):
        place = f"{table.path}, {CARD}"
        raise DivergenceError("another text", place=place, expected="what follows from the rows")


def _check_judge(table: SpaceTable, judge: SpaceTable) -> None:
    """Check that the networks of a judge are those that the model puts first, and its seeds those that follow."""
    networks, seed = put_first(table, len(judge.trained)), table.header.settings.seed
    for number, (row, expected) in enumerate(zip_longest(judge.trained, networks), start=1):
        if row != expected:
            place, said = f"{table.path}, {JUDGE}{TRAININGS}, network {number}", f"network {expected}"
            raise DivergenceError(f"network {row}", place=place, expected=f"{said}, in the order of the genes' model")
    seeds = tuple(judge_seed(seed, number) for number in range(len(judge.header.seeds)))
    if judge.header.seeds != seeds:
        place, said = f"{table.path}, {JUDGE}{HEADER}, seeds", f"{list(seeds)}, those that follow from seed {seed}"
        raise DivergenceError(f"{list(judge.header.seeds)}", place=place, expected=said)


def _simulated(table: SpaceTable) -> DataFacts:
    """Return what is known of simulated data before an image is drawn; the rest is as the table has it."""
    config, facts = table.header.settings, table.header.data
    if (images := sum(facts.counts)) != config.data.images:  # before so many presses are drawn
        place, expected = f"{table.path}, table.json, data.counts", f"{config.data.images} images in all (data.images)"
        raise DivergenceError(str(images), place=place, expected=expected)
    try:
        catalogue = source_of(config).catalogue()
        parts = split_rows(catalogue, config.data.split, config.data.split_seed, config.data.held_out)
    except (ConfigError, DataError) as error:
        raise BundleError(
            error.got, place=f"{table.path}, table.json, {error.place}", expected=error.expected
        ) from error
    return replace(
        facts,
        kind=catalogue.kind,
        counts=(len(parts.train), len(parts.validation), len(parts.test)),
        in_channels=3,
        image_size=catalogue.image_size,
        outputs=len(catalogue.names),
        names=catalogue.names,
        selected=catalogue.selected,
        groups=(),
    )


def _check_facts(table: SpaceTable, facts: DataFacts) -> None:
    """Compare what a table says of its data with what they are."""
    recorded, found = to_json(table.header.data), to_json(facts)
    for name in sorted(recorded.keys() | found.keys()):
        if recorded.get(name) != found.get(name):
            place, expected = f"{table.path}, table.json, data.{name}", f"{found.get(name)}, as the data have it"
            raise DivergenceError(f"{recorded.get(name)}", place=place, expected=expected)


def measure_table(table: SpaceTable, view: Progress) -> str:
    """Put every network of a table through the gate again, compare verdicts and profiles, and say what was compared.

    Args:
        table: a verified one. The gate runs its networks; they are those of our grammar, but for the baseline, whose
            text is the table's own.
        view: shows the progress.

    Returns:
        One sentence; where this cannot be done here, the reason.

    Raises:
        DivergenceError: the first network that the gate judges otherwise.
    """
    header, config = table.header, table.header.settings
    left = "profiles and verdicts of the gate were not compared"
    if header.made_up:
        return f"{left}: nothing of a made-up table was measured"
    if any(getattr(header.rules, part) not in LIKE_TODAY[part] for part in ("static", "probe")):
        return f"{left}: other rules ({header.rules.static}, {header.rules.probe}) made them"
    executor = ExecutorConfig(kind=HERE, workers=usable_cores())
    # Whatever walls there are confine the networks; the table may not ask for none.
    training, sandbox = (
        replace(config.training, device=Device.cpu, gpu=None),
        SandboxConfig(require=Confinement.process),
    )
    config = replace(config, executor=executor, training=training, sandbox=sandbox)
    try:
        check_means(config)
    except (SandboxError, ConfigError) as error:
        return f"{left}: {error}"
    with Workbench(config, header.task, header.data, Mode.live, say=view.say) as bench:
        gate = bench.gate(CURRENT)
        verdicts = bench.executor.map(gate.inspect, [network.source for network in table.networks])
        for row, (network, verdict) in enumerate(zip(table.networks, verdicts, strict=True), start=1):
            now = network_of(verdict, network.genome, network.source)
            if now.rejection is not None and now.rejection.reason in BY_MACHINE:
                return f"{left}: network {row} ended with {now.rejection.reason} here"
            if _judged(now) != _judged(network):
                place = f"{table.path}, networks.jsonl, line {row}"
                first = ".".join(map(str, next(iter(differences(_judged(now), _judged(network))), ())))
                raise DivergenceError(f"another {first}", place=place, expected="what the gate says of its source")
            view.advance("networks", row, len(table.networks))
    networks = counted(len(table.networks), "network")
    return f"{networks} went through the gate again, on noise alone: verdicts and profiles are as recorded"


def _judged(network: TableNetwork) -> Json:
    """Return what the gate says of a network, without what it tells people."""
    rejection = None if network.rejection is None else replace(network.rejection, detail="")
    return to_json(replace(network, rejection=rejection))


def retrain_table(table: SpaceTable, count: int | None, draw: int, store: str | None, view: Progress) -> str:
    """Train rows of a table, or of its judge, again, and compare every bit; say what was compared.

    Args:
        table: a verified one, or the judge of one.
        count: how many rows to draw; None for all of them.
        draw: the number that the draw follows from, which no author of the table may know.
        store: where the images are kept, if not where the table's maker had them.
        view: shows the progress, and why equal bits are not promised.

    Raises:
        BundleError: it is made up; or its networks would run without walls.
        RunError: this release cannot train as it was trained.
        DivergenceError: the first difference.
        DataError: the data set is missing, or is another one.
    """
    header, config = table.header, table.header.settings
    if header.made_up:
        expected = "one whose networks were trained"
        raise BundleError("a made-up table", place=str(table.path), expected=expected)
    check_known("study", header.study, TRAININGS_OF_STUDIES, table.path)
    if config.sandbox.require is Confinement.none:
        got = "sandbox.require=none, with which its networks would run here without walls"
        raise BundleError(got, place=str(table.path), expected="a table whose networks can be confined")
    workers = min(config.executor.workers, usable_cores())
    executor = replace(config.executor, workers=workers, address=None)
    config = replace(config, executor=executor, store=config.store if store is None else StoreConfig(root=store))
    check_means(config)
    doubts = doubts_of(header, config.numerics.kind, config.training.device, versions(), machine())
    for doubt in doubts:
        view.say(f"equal bits are not promised: {doubt}")
    rows = list(range(len(table.trainings)))
    if count is not None and count < len(rows):
        rows = sampled(rows, count, draw)
    data = load_same(config, header.data, view)
    _check_facts(table, data.facts.as_said_by(header.data))
    if (trivial := trivial_of(config, header.task, data)) != header.trivial:
        place = f"{table.path}, trivial"
        raise DivergenceError(str(header.trivial), place=place, expected=f"{trivial}, by the validation labels")
    with Workbench(config, header.task, data.facts, Mode.live, data=data, say=view.say) as bench:
        evaluator = bench.studies(header.study, data.scale, predictions=False)
        trainings = [table.trainings[row] for row in rows]
        jobs = [(table.networks[one.network].source, header.seeds[one.seed]) for one in trainings]
        verdicts = bench.executor.map(lambda job: evaluator.retrain(*job), jobs)
        for done, (row, training, verdict) in enumerate(zip(rows, trainings, verdicts, strict=True), start=1):
            recorded = training.verdict
            now, then = ({**to_json(each), "detail": ""} for each in (verdict, recorded))  # that is for people
            if now != then:
                first = ".".join(map(str, next(iter(differences(then, now)), ())))
                place, remedy = f"{table.path}, {table.part}{TRAININGS}, line {row + 1}", "; ".join(doubts)
                raise DivergenceError(f"another {first}", place=place, expected="what was recorded", remedy=remedy)
            view.say(f"{table.part}{TRAININGS}, line {row + 1}: as recorded ({done} of {len(rows)})")
    drawn = "" if count is None else f", drawn at random (--draw {draw} repeats this)"
    every = f"{counted(len(table.trainings), 'training')}{' of the judge' if table.part else ''}"
    return f"{len(rows)} of {every} were trained again: every bit is as recorded{drawn}"
