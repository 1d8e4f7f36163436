"""Labelled datasets, their files and stores."""
