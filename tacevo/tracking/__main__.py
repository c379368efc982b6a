"""The mirror's process: `python -m tacevo.tracking RUN_DIR... --uri URI --experiment NAME [--follow]`.

With `--follow` it continues until its standard input ends, which also happens when the search is killed. Several runs
are mirrored one after the other. When one fails, the exit status is 1 and the last line of output is the reason.
"""

import argparse
import select
import sys
import traceback
from pathlib import Path

from tacevo.sandbox.kernel import keep_priority, lower_priority
from tacevo.tracking.address import prepare, store_address, without_address

_LOW_PRIORITY = 10

_PAUSE_SECONDS = 1.0


def main() -> int:
    """Mirror runs; return the exit status."""
    options = _options()
    lower_priority(_LOW_PRIORITY)  # the processors are the search's
    keep_priority()
    prepare()
    reason = ""
    for run_dir in options.run_dirs:
        try:
            from tacevo.tracking.mirror import mirror

            mirror(
                run_dir,
                uri=store_address(options.uri),
                experiment=options.experiment,
                finished=_has_input_ended if options.follow else None,
            )
        except Exception as error:  # of any class: it ends the mirror, never the search
            print(without_address(traceback.format_exc()), file=sys.stderr)
            reason = without_address(f"{type(error).__name__}: {error}".partition("\n")[0])
    if reason:
        print(reason, file=sys.stderr)
    return 1 if reason else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tacevo.tracking", description="Mirror runs in MLflow.")
    parser.add_argument("run_dirs", type=Path, nargs="+", metavar="RUN_DIR")
    parser.add_argument("--uri", default="", help="MLflow tracking URI (default: MLFLOW_TRACKING_URI)")
    parser.add_argument("--experiment", required=True, help="the name of the MLflow experiment")
    parser.add_argument("--follow", action="store_true", help="continue until standard input ends")
    return parser.parse_args()


def _has_input_ended() -> bool:
    """Wait a moment for the end of standard input; return whether it came."""
    return bool(select.select([sys.stdin], [], [], _PAUSE_SECONDS)[0])


if __name__ == "__main__":
    sys.exit(main())
