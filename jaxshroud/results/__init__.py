"""Results: labelled numbers that are shown, saved and drawn alike. No module here imports JAX when it is imported."""
