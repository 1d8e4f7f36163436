"""What a user writes down: a scene, its numbers and their keys, files."""

import lazy_loader

PLACES = {
    "scene": [
        "Blades",
        "Contact",
        "Drive",
        "Friction",
        "Number",
        "PerBlade",
        "Scene",
        "Shroud",
        "per_blade",
        "scalar",
        "with_parts",
    ],
    "parts": ["ContactLaw", "FrictionLaw", "MISPRINTS", "MOTIONS", "Neighbour", "Parts", "misprints"],
    "motion": ["AT_REST", "Motion"],
    "keys": ["key_parts"],
    "vary": ["NUMERIC_KEYS", "value_of", "vary"],
}
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs=PLACES)
