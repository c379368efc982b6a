"""The mirror's process: `TACEVO_TRACKING_URI=URI python -m tacevo.tracking RUN_DIR --experiment NAME [--follow]`.

With `--follow` it goes on until its standard input ends, which happens too when the search at the other end is
killed. On failure it ends with status 1, and its last line of output says why. Whatever it writes, MLflow's own
messages included, is without the password of the URI.
"""

import argparse
import contextlib
import os
import select
import sys
import traceback
from pathlib import Path

from tacevo.redaction import Veil
from tacevo.tracking.process import URI_VARIABLE, prepare

_LOW_PRIORITY = 10

_PAUSE_SECONDS = 1.0


def main() -> int:
    """Mirror one run; return the exit status."""
    parser = _parser()
    options = parser.parse_args()
    uri = os.environ.get(URI_VARIABLE)
    if not uri:
        parser.error(f"{URI_VARIABLE} is not set; set it to the MLflow tracking URI")
    with contextlib.redirect_stdout(Veil(sys.stdout, uri)), contextlib.redirect_stderr(Veil(sys.stderr, uri)):
        return _mirror(options, uri)


def _mirror(options: argparse.Namespace, uri: str) -> int:
    _step_back()
    prepare()
    from tacevo.tracking.mirror import mirror

    finished = _input_ended if options.follow else None
    try:
        mirror(options.run_dir, uri=uri, experiment=options.experiment, finished=finished)
    except Exception as error:  # whatever it is: it is told in the log and ends the mirror alone
        traceback.print_exc()
        print(f"{type(error).__name__}: {_first_line(str(error))}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tacevo.tracking", description="Mirror a run in MLflow.")
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR")
    parser.add_argument("--experiment", required=True, help="the name of the MLflow experiment")
    parser.add_argument("--follow", action="store_true", help="go on until standard input ends")
    return parser


def _step_back() -> None:
    """Leave the processors to the search."""
    os.nice(_LOW_PRIORITY)
    with contextlib.suppress(OSError):  # where Linux groups by session, nice counts only inside the own group
        Path("/proc/self/autogroup").write_text(str(_LOW_PRIORITY))


def _first_line(text: str) -> str:
    return text.partition("\n")[0]


def _input_ended() -> bool:
    """Wait a moment for the end of standard input; say whether it came."""
    return bool(select.select([sys.stdin], [], [], _PAUSE_SECONDS)[0])


if __name__ == "__main__":
    sys.exit(main())
