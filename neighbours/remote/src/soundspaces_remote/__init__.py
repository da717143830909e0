"""Datasets behind a URL: `soundspaces_sim.open_dataset` reads them as folders, by what is here."""
