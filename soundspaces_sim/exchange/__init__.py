"""Datasets to and from the formats of others: SoundSpaces 1, SOFA, WAV; point lists and graphs."""
