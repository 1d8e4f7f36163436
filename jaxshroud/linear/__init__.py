"""Blades and their contact as one linear system: rest, natural modes, settled motions and what dies out."""
