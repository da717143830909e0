"""What every room stands on: errors, settings, bands, air, random streams, files, compiled functions."""
