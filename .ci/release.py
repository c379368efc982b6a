"""Make a release from a clean checkout, try it in empty environments, and write what a person then uploads.

    python .ci/release.py [--pythons python3.11 python3.12 ...]

It writes wheel and source archive into dist/, checks them, installs the wheel with the locked packages for each Python
that is there, and runs in each what a user runs first. Images are built where a builder is at hand. dist/RELEASE.md
says what was tried, what was not and why, and what a person uploads. The first failure ends it.
"""

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST, PLACE = ROOT / "dist", ROOT / "build" / "release"
VERSION = str(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])

#: The programs of the versions of Python that are supported.
PYTHONS = ("python3.11", "python3.12", "python3.13")

#: What a user does first, in an empty directory; PUBLISHED is a published run, which no wheel has.
FIRST = (
    "tacevo --help",
    "tacevo replay {published}",
    "tacevo search experiment=demo run.dir=runs/demo tracking=none",
    "tacevo replay runs/demo",
    "tacevo init shear --like force",
    "tacevo init mine --part parents",
)

#: The published run of FIRST; the page beside it has the digest that its replay must end with.
PUBLISHED = "grating-claude.zip"


def main() -> None:
    """Do all of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pythons", nargs="+", default=PYTHONS, metavar="PYTHON", help="programs to install with")
    pythons = parser.parse_args().pythons
    _check_checkout()
    shutil.rmtree(DIST, ignore_errors=True)
    shutil.rmtree(PLACE, ignore_errors=True)
    tools = _environment(sys.executable, "tools")
    _run([tools / "pip", "install", "--quiet", "build", "twine", "hatchling"])
    _run([tools / "python", "-m", "build", "--outdir", DIST, ROOT])
    files = sorted(DIST.iterdir())
    _run([tools / "twine", "check", "--strict", *files])
    tried = [_tried(python, next(DIST.glob("*.whl"))) for python in pythons]
    if all("not tried" in line for line in tried):
        sys.exit(f"expected one of {', '.join(pythons)}; got none of them: name yours by --pythons")
    docker = _image("docker", ["build", "--tag", f"tacevo:{VERSION}", "--tag", "tacevo:latest", ROOT], ["info"])
    apptainer = "- apptainer: not tried, it packs the image of docker, which was not built"
    if docker.endswith("built"):
        apptainer = _image("apptainer", ["build", "--force", PLACE / "tacevo.sif", ROOT / "tacevo.def"], ["version"])
    conda = _image("conda-build", ["--channel", "conda-forge", ROOT / ".ci/conda"], ["--version"])
    tried += [docker, apptainer, conda]
    report = _report(files, tried)
    (DIST / "RELEASE.md").write_text(report, encoding="utf-8")
    print(report)


def _check_checkout() -> None:
    """Refuse a checkout with changes, and one whose files name different versions."""
    if changed := _said(["git", "-C", ROOT, "status", "--porcelain"]):
        sys.exit(f"expected a clean checkout; got changes: commit them, or clone anew\n{changed}")
    citation = (ROOT / "CITATION.cff").read_text()
    named = {
        "CITATION.cff": re.findall(r"^version: (.+)$", citation, re.MULTILINE),
        "tacevo/__init__.py": re.findall(
            r'^__version__ = "(.+)"$', (ROOT / "tacevo/__init__.py").read_text(), re.MULTILINE
        ),
        "CHANGELOG.md": re.findall(r"^## ([\d.]+) ", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[:1],
    }
    if others := {name: found for name, found in named.items() if found != [VERSION]}:
        sys.exit(f"expected {VERSION} of pyproject.toml everywhere; got {others}")


def _tried(python: str, wheel: Path) -> str:
    """Install the wheel into an empty environment with the locked packages, and run what a user runs first."""
    program = shutil.which(python)
    if program is None:
        return f"- {python}: not tried, it is not installed here"
    asked = subprocess.run([program, "--version"], capture_output=True, text=True, check=False)
    if asked.returncode:
        return f"- {python}: not tried, `{python} --version` fails here"
    version = asked.stdout.strip()
    place = _environment(program, Path(python).name)
    pip = [place / "pip", "install", "--quiet", "--disable-pip-version-check"]
    _run([*pip, "--no-deps", "--require-hashes", "--requirement", ROOT / "requirements.lock"])
    _run([*pip, "--requirement", ROOT / "torch.lock"])
    _run([*pip, "--no-deps", wheel])
    _run([place / "pip", "check"])
    ends = []
    with tempfile.TemporaryDirectory() as folder:
        for command in FIRST:
            name, *words = [word.format(published=ROOT / "cache/published" / PUBLISHED) for word in command.split()]
            ends.append(_said([place / name, *words], folder).splitlines()[-1])
    if ends[1].removeprefix("digest: ") not in (ROOT / "cache/published/README.md").read_text():
        sys.exit(f"{python}: expected the digest of {PUBLISHED} that its page has; got {ends[1]}")
    if ends[2] != ends[3]:
        sys.exit(f"{python}: expected the demo's search and its replay to end alike; got {ends[2]} and {ends[3]}")
    commands = ", ".join(f"`{command.format(published=PUBLISHED)}`" for command in FIRST)
    return f"- {version}: installed; {commands}; the demo's {ends[2]}"


def _image(builder: str, build: list[str | Path], asked: list[str]) -> str:
    """Build an image where its builder works here."""
    program = shutil.which(builder)
    if program is None:
        return f"- {builder}: not tried, it is not installed here"
    if subprocess.run([program, *asked], capture_output=True, check=False).returncode:
        return f"- {builder}: not tried, it is installed but does not work here (`{builder} {' '.join(asked)}` fails)"
    _run([program, *build])
    return f"- {builder}: built"


def _report(files: list[Path], tried: list[str]) -> str:
    """Say what was made and tried, and what a person does now."""
    commit = _said(["git", "-C", ROOT, "rev-parse", "HEAD"])
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in files]
    names = " ".join(f"dist/{path.name}" for path in files)
    steps = (
        f"git tag --sign v{VERSION} {commit} && git push origin v{VERSION}",
        f"twine upload {names}",
        f"gh release create v{VERSION} {names} --notes-file CHANGELOG.md",
    )
    return "\n".join(
        [
            f"# Release {VERSION}",
            "",
            f"Of commit {commit}.",
            "",
            "```text",
            *sums,
            "```",
            "",
            "## Tried",
            "",
            *tried,
            "",
            "## To do by a person, who has the logins",
            "",
            "```sh",
            *steps,
            "```",
            "",
            "Published runs are deposited by `tacevo publish --deposit` (docs/publishing.md).",
            "",
        ]
    )


def _environment(program: str, name: str) -> Path:
    """Make an empty environment; return where its programs lie."""
    _run([program, "-m", "venv", PLACE / name])
    return PLACE / name / "bin"


def _run(command: list[str | Path], folder: str | Path = ROOT) -> None:
    print("+", *command, flush=True)
    subprocess.run(command, cwd=folder, check=True)


def _said(command: list[str | Path], folder: str | Path = ROOT) -> str:
    print("+", *command, flush=True)
    return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


if __name__ == "__main__":
    main()
