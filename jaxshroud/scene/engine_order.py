"""The engine order of a scene: the drive periods in one revolution of the rotor."""

from jaxshroud.scene.scene import Scene


def engine_order_of(scene: Scene) -> float | None:
    """The engine order by which a scene is given; None where only the frequency of its drive is known."""
    order = getattr(scene, "given", {}).get("drive.engine_order")
    return None if order is None else float(order)
