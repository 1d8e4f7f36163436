"""Kinds of points on a branch of orbits, by the numbers that files hold."""

KINDS = ("regular", "fold", "flip", "Neimark-Sacker", "branch point", "corner", "jump", "grazing")
