"""Datasets as their users see them: their format, their reader, and what is made of them."""
