"""Collections of generated buildings: `make collection`."""
