"""A page on this machine that shows a scene: its diagram, its map, and the motion under a click."""
