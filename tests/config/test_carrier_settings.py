"""Promise: a temperature that cannot reach the model is refused before anything is asked, with what can be chosen."""

from pathlib import Path

import pytest
from refusals import refused

from tacevo.choices import Carrier, Effort
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.conf_folder import conf_root, groups
from tacevo.config.identity import identity
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.errors import ConfigError
from tacevo.records import to_json
from tacevo.runs.providers import check_temperature

EFFORT = "temperature.carrier=effort"


@pytest.mark.parametrize("llm", ["grammar", "anthropic", "openai"])
@pytest.mark.parametrize("carrier", [*Carrier])
def test_every_carrier_goes_with_every_provider_of_ours(llm: str, carrier: str) -> None:
    """It is recorded only where it is not the parameter, so that earlier runs keep their identity."""
    config = compose([f"llm={llm}", "llm.model=grammar-2", f"temperature.carrier={carrier}"])
    recorded = {"rule": "paper", "start": 0.6, "step": 0.05, "jitter": 0.1}
    recorded |= {} if carrier == "parameter" else {"carrier": carrier}
    assert identity(config)["temperature"] == to_json(config.temperature) == recorded


def test_efforts_decide_where_they_are_chosen_from() -> None:
    """And are refused elsewhere, as those are of which a temperature cannot choose."""
    config = compose([EFFORT, "temperature.efforts=[low,xhigh]"])
    assert config.temperature.efforts == (Effort.low, Effort.xhigh)
    assert identity(config) != identity(compose([EFFORT]))
    for wrong in ("[high,low]", "[low]", "[]", "[low,low]"):
        with refused(ConfigError, place="temperature.efforts", expected="at least two of low, medium"):
            compose([EFFORT, f"temperature.efforts={wrong}"])
    with refused(ConfigError, place="temperature.efforts", expected="without temperature.carrier=effort"):
        compose(["temperature.efforts=[low,max]"])
    with refused(ConfigError, place="llm.effort", expected="null with temperature.carrier=effort"):
        compose(["llm=anthropic", "llm.effort=low", EFFORT])


@pytest.mark.parametrize("task", groups()["task"])
def test_every_task_has_sentences_that_rise(task: str) -> None:
    """Five different ones, which name no task, from one change to a departure."""
    config = compose([f"task={task}", "temperature.carrier=words"])
    first, *_, last = sentences = load_task(config, facts_without_data(config)).boldness
    assert len({*sentences}) == 5
    assert ("Change one thing" in first, "Depart boldly" in last) == (True, True)


@pytest.mark.parametrize(
    ("sentences", "got"),
    [
        ("", "0 sentences"),
        ("boldness: [A., B., C.]\n", "3 sentences"),
        ("boldness: [A., B., C., D., D.]\n", "equal sentences"),
        ('boldness: [A., B., C., D., "two\\nlines"]\n', "two\nlines"),
        ("boldness: [A., B., C., D., '']\n", "''"),
    ],
)
def test_library_without_five_sentences_is_refused(sentences: str, got: str, tmp_path: Path) -> None:
    """Only where words carry the temperature, if it has none; the error says where they are written."""
    library = (conf_root() / "library/force/instructions.yaml").read_text()
    head, _, rest = library.partition("boldness:")
    file = tmp_path / "instructions.yaml"
    file.write_text(head + sentences + rest[rest.index("mutations:") :])
    own = [f"task.instructions={file}", "temperature.carrier=words"]
    config = compose(own)
    with pytest.raises(ConfigError) as caught:
        load_task(config, facts_without_data(config))
    assert "boldness" in caught.value.place
    if not sentences:
        assert got in caught.value.got
        assert "copy those of conf/library/force/instructions.yaml" in caught.value.remedy
        plain = compose(own[:1])
        assert load_task(plain, facts_without_data(plain)).boldness == ()


@pytest.mark.parametrize(
    "compared",
    [
        ["ablation=fixed_temperature"],
        ["ablation=fixed_temperature_0"],
        ["ablation=stall_temperature"],
        ["temperature=fixed"],
        ["temperature.start=0.2"],
    ],
)
def test_arm_over_a_temperature_that_nothing_carries_is_refused(compared: list[str], place: Path) -> None:
    """It would be the search without it, by construction; the carrier itself is an arm."""
    config = compose([*compared, "temperature.carrier=none"])
    with refused(ConfigError, place=compared[0], got="temperature.carrier=none", remedy="temperature.carrier=words"):
        check_temperature(compared, config)
    for carrier in ("words", "effort", "parameter"):
        check_temperature(compared, compose([*compared, f"temperature.carrier={carrier}"]))
    check_temperature(["temperature.carrier=none"], compose(["temperature.carrier=none"]))


def test_sweep_of_arms_over_a_temperature_that_nothing_carries_is_not_begun(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is made, and the line names the arm."""
    arms = ["ablation=none,fixed_temperature", "seed=0,1"]
    assert main(["search", "-m", "experiment=demo", "temperature.carrier=none", *arms]) == 2
    assert "ablation=fixed_temperature: expected a carrier" in capsys.readouterr().err
    assert list(place.iterdir()) == []


def test_paper_today_has_a_model_of_today_whose_temperature_words_carry() -> None:
    """All else is as in the paper's experiments, which stay literal; another model or task may be named."""
    today = compose(["experiment=paper_today"])
    literal = compose(["experiment=paper_force", "llm=anthropic"])
    assert today.llm.model == "claude-haiku-5-5"
    assert (today.temperature.carrier, literal.temperature.carrier) == (Carrier.words, Carrier.parameter)
    told, plain = identity(today), identity(literal)
    assert told["temperature"] == {**plain["temperature"], "carrier": "words"}  # type: ignore[dict-item]
    assert told["llm"] == {**plain["llm"], "model": "claude-haiku-5-5"}  # type: ignore[dict-item]
    for each in (told, plain):
        del each["temperature"], each["llm"]
    assert told == plain
    other = compose(["experiment=paper_today", "task=grating", "llm.model=claude-sonnet-5-5"])
    assert (other.task.name, other.llm.model) == ("grating", "claude-sonnet-5-5")
    assert other.data.images == compose(["experiment=paper_grating", "llm=anthropic"]).data.images
    assert compose(["experiment=paper_today", "llm=grammar"]).llm.model == "grammar-2"
