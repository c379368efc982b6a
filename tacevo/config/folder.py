"""Where the configs lie, which choices each group has, and the files that they name."""

from collections.abc import Iterable
from pathlib import Path

from tacevo.errors import ConfigError


def conf_root() -> Path:
    """Find the directory of configs: inside an installed package, or beside it in a checkout.

    Raises:
        ConfigError: both are missing.
    """
    here = Path(__file__).parents[1]
    for folder in (here / "conf", here.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(
        "nothing", place=str(here / "conf"), expected="the directory conf/", remedy="install tacevo again"
    )


def checkout_root() -> Path:
    """Find the directory of configs of a checkout, to which a user may add.

    Raises:
        ConfigError: tacevo is installed: what is added to its package goes with the next update.
    """
    root = conf_root()
    if root.parent == Path(__file__).parents[1]:
        got = f"{root}, which belongs to an installed package"
        remedy = "clone the repository, and use the .venv/bin/tacevo that `make setup` builds there"
        raise ConfigError(got, expected="the directory conf/ of a checkout", remedy=remedy)
    return root


def groups() -> dict[str, list[str]]:
    """List the choices of every config group, e.g. `{"task": ["force", "grating", "hardness"], ...}`."""
    folders = sorted(folder for folder in conf_root().iterdir() if folder.is_dir() and folder.name != "library")
    return {folder.name: sorted(path.stem for path in folder.glob("*.yaml")) for folder in folders}


def check_experiment(overrides: Iterable[str]) -> None:
    """Check that the size of a search is chosen: conf/config.yaml itself is that of the paper, and takes days.

    Raises:
        ConfigError: no experiment is chosen.
    """
    if not any(override.startswith("experiment=") for override in overrides):
        raise ConfigError(
            "none",
            place="experiment",
            expected=f"one of {', '.join(groups()['experiment'])}",
            remedy="experiment=demo takes minutes; experiment=null is conf/config.yaml: 1,011 trainings at 256 px",
        )


def read_named(key: str, name: str) -> str:
    """Read a file that a configuration names, relative to conf/ or absolute."""
    path = conf_root() / name
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}, which cannot be read ({error})", place=key, expected="a text file") from error
