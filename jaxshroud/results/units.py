"""Units and dimensions of a scene's numbers in results."""

from jaxshroud.scene.motion import Motion

UNITS = {  # of the scene's numbers, by key
    **dict.fromkeys(("blades.m", "blades.m_y"), "kg"),
    "blades.I": "kg m2",
    **dict.fromkeys(("blades.k_x", "blades.k_y", "contact.k", "friction.k_d"), "N m-1"),
    "blades.k_T": "N m rad-1",
    **dict.fromkeys(("blades.c_x", "blades.c_y"), "N s m-1"),
    "blades.c_T": "N m s rad-1",
    **dict.fromkeys(("shroud.l_oa", "shroud.l_ab", "shroud.gap", "contact.width", "initial.x", "initial.y"), "m"),
    **dict.fromkeys(("shroud.alpha", "drive.beta", "drive.phase", "initial.theta"), "rad"),
    **dict.fromkeys(("drive.omega", "initial.v_theta"), "rad s-1"),
    "drive.F_0": "N",
    "drive.M_0": "N m",
    **dict.fromkeys(("initial.v_x", "initial.v_y"), "m s-1"),
}


def unit(key: str) -> str:
    """The unit of the number that a key names, for one blade or both."""
    return UNITS.get(key.partition("[")[0], "1")


def dimension(key: str) -> str:
    """Name of the dimension along `key`: its last word, but `initial_x` where a variable has that name."""
    table, name = key.split(".")
    stem, _, blade = name.partition("[")
    stem = f"{table}_{stem}" if stem in Motion._fields or stem in ("period", "blade") else stem
    return stem + {"": "", "0]": "_left", "1]": "_right"}[blade]
