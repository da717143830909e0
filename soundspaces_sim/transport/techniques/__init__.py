"""The ways of making a path, one file each."""
