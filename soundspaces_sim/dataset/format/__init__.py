"""What lies on disk: shards, manifest, their schema, checks."""
