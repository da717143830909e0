"""How far results are from known answers, from measured rooms and from other programs."""
