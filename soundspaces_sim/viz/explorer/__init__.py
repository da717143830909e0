"""An explorer of datasets in the browser: served on this machine alone, or as a folder that opens from disk."""
