"""Echograms to pressure: ambisonic and binaural responses, and dry sounds through them."""
