"""Finished runs, studies and sweeps as records, read and checked once: for commands, API, bundles and analysis.

- `run.read_run` reads the directory of a finished run. Ledger, run.json and both archives agree, or RunError names the
  file. What this machine has elsewhere, stores and data, is found by `settings`; a bundle's word on it counts nothing.
- `study_directory` writes and reads a study: study.json and the sealed scores. `read_finished` checks both and returns
  a `FinishedStudy`; of it `study.as_study` makes a `RecordedStudy`, with one score for each network and seed.
- `sweep.load_sweep` reads the finished jobs of a sweep, says why the others are missing, and takes the test scores of
  the networks that each job found (`job_scores`). A job whose run is another one is refused.
- `sweep_jobs.check_jobs` compares all jobs with their runs, for replays; `sweep_checks.check_sweep` refuses runs of
  unequal data, budget, rules or versions, before arms are compared.
- `publishable` takes out of settings what belongs to one machine. `summary` writes what a run found.
- `space_table` writes, reads and finds the table of a space; only `looked_up` and `table_header` know it elsewhere.

Nothing here trains, asks a model, or draws. Bytes, keys and digests of files are those of the release that wrote them.
"""
