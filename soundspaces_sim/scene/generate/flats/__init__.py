"""Generated flats: rooms and doors on a lattice of 1 m cells, furniture, and the boxes they are made of."""
