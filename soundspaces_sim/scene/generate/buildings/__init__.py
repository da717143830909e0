"""Generated buildings: shells of rooms with openings, furniture as data, and a file per type of building."""
