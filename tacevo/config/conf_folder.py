"""The directory of the configs, the choices of each group, and the files that they name."""

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacevo.errors import ConfigError

#: The variable that names the directory of configs of a user's own; --config-dir sets it.
CONFIG_DIR = "TACEVO_CONFIG_DIR"


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


def own_root() -> Path:
    """Return the directory of configs of a user's own, which may be missing: what --config-dir names, else ./conf."""
    return Path(os.environ.get(CONFIG_DIR) or "conf")


@contextlib.contextmanager
def reading_own(folder: str | None) -> Iterator[None]:
    """Let `own_root`, here and in the processes that are started, be this directory; None leaves it as it is."""
    before = os.environ.get(CONFIG_DIR)
    if folder is not None:
        os.environ[CONFIG_DIR] = os.path.abspath(folder)
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(CONFIG_DIR, None)
        else:
            os.environ[CONFIG_DIR] = before


def config_roots() -> tuple[Path, ...]:
    """Return the directories of configs that there are: that of tacevo, then the user's own where it is another."""
    shipped, own = conf_root(), own_root()
    return (shipped, own.resolve()) if own.is_dir() and not own.samefile(shipped) else (shipped,)


def config_file(name: str, key: str) -> Path:
    """Find a file by its name relative to a directory of configs, as the setting `key` names it.

    Raises:
        ConfigError: tacevo and the user have different files of this name.
    """
    roots = config_roots()
    first, *others = [path for root in roots if (path := root / name).is_file()] or [roots[0] / name]
    if any(other.read_bytes() != first.read_bytes() for other in others):
        got = f"{others[0]}, which differs from {first}"
        remedy = "rename it, and what names it, or start in another directory"
        raise ConfigError(got, place=key, expected="a name that tacevo has no file of", remedy=remedy)
    return first


def groups() -> dict[str, list[str]]:
    """List the choices of every config group, e.g. `{"task": ["force", "grating", "hardness"], ...}`.

    The user's own directory adds choices to the groups of tacevo, and no group.
    """
    folders = sorted(folder for folder in conf_root().iterdir() if folder.is_dir() and folder.name != "library")
    return {
        folder.name: sorted({path.stem for root in config_roots() for path in (root / folder.name).glob("*.yaml")})
        for folder in folders
    }


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
    """Read a file that a configuration names, relative to a directory of configs (`config_file`) or absolute."""
    path = config_file(name, key)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}, which cannot be read ({error})", place=key, expected="a text file") from error
