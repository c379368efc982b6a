"""Where the configs lie, and which choices each group has."""

from pathlib import Path

from tacevo.errors import ConfigError


def conf_root() -> Path:
    """Find the folder of configs: inside an installed package, or beside it in a checkout.

    Raises:
        ConfigError: there is neither.
    """
    here = Path(__file__).parents[1]
    for folder in (here / "conf", here.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"conf/ was expected in {here} or beside it and is in neither; install tacevo again")


def groups() -> dict[str, list[str]]:
    """List the choices of every config group, e.g. `{"task": ["force", "grating", "hardness"], ...}`."""
    folders = sorted(folder for folder in conf_root().iterdir() if folder.is_dir() and folder.name != "library")
    return {folder.name: sorted(path.stem for path in folder.glob("*.yaml")) for folder in folders}
