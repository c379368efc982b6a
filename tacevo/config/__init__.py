"""The settings of a user: schemas, composition, identity, and the configuration that a run recorded."""
