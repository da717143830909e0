"""Energy against time: echograms, room measures, band filters."""
