"""The command `explain`."""

import argparse

from jaxshroud.batch.xla import alone
from jaxshroud.cli.asked import loaded, method
from jaxshroud.cli.terminal import blamed, print_table
from jaxshroud.march.method import FAST
from jaxshroud.scene.parts import Parts
from jaxshroud.verbs.explain import explain


def explain_verb(options: argparse.Namespace) -> None:
    """Say what the model of a scene consists of."""
    file = loaded(options)
    chosen, choice = method(file, alone(file.scene), options, FAST)
    with blamed(file.name):
        told = explain(file.scene, chosen)
    whole = zip(Parts._fields, told.parts, Parts(), strict=True)
    lacks = [f"{name}: {part}" for name, part, full in whole if part != full]
    operations = f"{told.operations}, {told.operations / told.full_operations:.2f} of the full model"
    if told.parts.contact == "none":
        operations = "none: closed form"
    rows = {
        "motion": ", ".join(told.parts.motion),
        "neighbour": told.parts.neighbour,
        "friction": told.parts.friction,
        "contact": told.parts.contact,
        "not the full model in": "; ".join(lacks) or "nothing",
        "events looked for": ", ".join(told.events) or "none",
        "numbers carried by a lane": told.numbers,
        "operations in a trial step": operations,
        "omega_max": f"{told.omega_max:.4g} rad/s",
        **{f"steps per period, {name}": n for name, n in told.steps.items()},
        **({} if choice is None else {"accuracy": choice}),
        **{f"note {i}": text for i, text in enumerate(told.advice, 1)},
    }
    print_table(file.title or file.name, rows)
