"""Datasets as their users see them."""
