"""Promise: the gate and the look at a data set say from Python what their commands say."""

import json
from pathlib import Path

import pytest
from refusals import refused

import tacevo
from tacevo.cli.app import main
from tacevo.config.conf_folder import conf_root


def test_verdicts_are_of_texts_and_files(place: Path) -> None:
    """In their order; what cannot be read stops no other, and a text that names a file is taken for a mistake."""
    baseline = (conf_root() / "library" / "force" / "baseline.py").read_text()
    (place / "good.py").write_text(baseline)
    files = [Path("absent"), Path("good.py")]
    frame = tacevo.check(*files, "I cannot help with that.", f"{baseline}\n", image_size=32)
    assert frame["verdict"].tolist() == ["unreadable", "admitted", "rejected", "admitted"]
    assert frame["file"].fillna("").tolist() == ["absent", "good.py", "", ""]
    assert frame.loc[0, "detail"].startswith("absent: expected the file of an answer")
    assert frame.loc[2, "stage"] == "extract"
    assert frame.loc[1, "parameters"] == frame.loc[3, "parameters"] > 0
    with refused(tacevo.ConfigError, place="answers", got="'good.py'", expected="pathlib.Path"):
        tacevo.check("good.py")


@pytest.mark.slow
def test_data_are_looked_at_as_by_the_command(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same findings, and the picture where it was asked for; what a search would refuse is refused."""
    settings = ["task=force", "data.images=40", "data.image_size=16"]
    ours = tacevo.check_data(*settings, sheet=place / "mine.png", quiet=True)
    assert capsys.readouterr().err == ""
    assert main(["data", "check", *settings, "--json"]) == 0
    theirs = json.loads(capsys.readouterr().out)
    assert {**ours, "sheet": ""} == {**theirs, "sheet": ""}
    assert (place / "mine.png").read_bytes() == Path(theirs["sheet"]).read_bytes()
    with refused(tacevo.ConfigError, place="data.images"):
        tacevo.check_data("task=force", "data.images=0", quiet=True)
