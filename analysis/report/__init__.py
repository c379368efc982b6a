"""All tables and figures of a run, a study or a sweep."""
