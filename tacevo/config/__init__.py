"""What a user may set: schemas, composition, identity, and the configuration that a run recorded."""
