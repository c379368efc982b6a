"""The model registry of an MLflow store, into which an exported network goes."""

from pathlib import Path

from tacevo.choices import Tracking
from tacevo.errors import RunError
from tacevo.export.contents import Exported
from tacevo.redaction import check_address
from tacevo.results.run import RecordedRun
from tacevo.tracking.mlflow_errors import told
from tacevo.tracking.params import shown_address
from tacevo.tracking.process import prepare, store_address


class Registry:
    """Where the networks of a run are registered under one name; looked at before anything is trained.

    Args:
        run: whose networks they are.
        name: of the model.
        uri: the tracking URI; empty for the run's own if it is tracked, or else that in MLFLOW_TRACKING_URI.

    Raises:
        ConfigError: the name or the address is not one.
        RunError: MLflow fails.
    """

    def __init__(self, run: RecordedRun, name: str, uri: str) -> None:
        check_address(uri, "--uri")
        tracking = run.config.tracking
        self._run, self._name = run, name
        self._uri = uri or ("" if tracking.kind is Tracking.none else tracking.uri)
        self._store = store_address(self._uri)
        prepare()
        with told(f"the model {name}", self._uri, "give another --uri, or export without --register"):
            from tacevo.tracking.models import check_registry  # MLflow takes seconds to import

            check_registry(name, self._store, tracking.experiment)

    def take(self, model: Exported, directory: Path) -> str:
        """Register an export; return in a line as what.

        Raises:
            RunError: MLflow fails, or ONNX cannot hold the network; the export stands.
        """
        if model.onnx is None:
            place, expected = f"the model {self._name}", "a model.onnx, which is what is registered"
            remedy = f"{directory} is whole without it"
            raise RunError(f"none: {model.without_onnx}", place=place, expected=expected, remedy=remedy)
        remedy = f"{directory} is whole; the same export into another -o registers it, from recorded trainings"
        with told(f"the model {self._name}", self._uri, remedy):
            from tacevo.tracking.models import register
            from tacevo.tracking.sweep_run import find_sweep
            from tacevo.tracking.writer import search_key

            sweep = find_sweep(self._run.path)
            sweep_name = "" if sweep is None else sweep[0].path.name
            version = register(
                directory,
                self._name,
                search=search_key(self._run.ledger.hashes[0], self._run.path.resolve().name, sweep_name),
                uri=self._store,
                experiment=self._run.config.tracking.experiment,
                metrics={name: value for name, (value, _, _) in model.metrics.items()},
            )
        return f"registered as models:/{self._name}/{version} in {shown_address(self._uri)}"
