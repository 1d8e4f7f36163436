"""What the page says of runs and of its work, as HTML."""

from collections.abc import Mapping
from html import escape
from typing import Any

from jaxshroud.io.lane_status import MESSAGES, status_name
from jaxshroud.model.modes import Status
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.keys import parse_key


def note_html(text: str, wrong: bool = False) -> str:
    """A remark, or what is wrong."""
    return (
        f'<div class="wrong" role="alert">{escape(text)}</div>' if wrong else f'<div class="soft">{escape(text)}</div>'
    )


def status_html(busy: str, wrong: str = "") -> str:
    """What is being done, and what went wrong."""
    said = f'<span class="wrong" role="alert">{escape(wrong)}</span>' if wrong else escape(busy or "Ready")
    return f'<div role="status" aria-live="polite">{said}</div>'


def shown_value(key: str, value: float) -> str:
    """A number with its unit, as pictures show it."""
    unit, factor = parse_key(key)[0].shown
    return f"{value * factor:.9g}{f' {unit}' if unit else ''}"


def motion_html(run: Any, selected: Mapping[str, float], file: SceneFile) -> str:
    """What motion is shown, and how its run ended."""
    place = ", ".join(f"{key} = {shown_value(key, value)}" for key, value in selected.items())
    head = f"Motion at {place}" if place else "Motion of the scene as it is on the left"
    status = int(run.status)
    failed = (
        "" if status == Status.OK else note_html(f"{status_name(status)}: {MESSAGES.get(Status(status), '')}", True)
    )
    periods = (
        f"{len(run.t) // run.steps_per_period} periods from rest; {run.method}, {run.steps_per_period} steps a period"
    )
    return f"<h2>{escape(head)}</h2>{failed}{note_html(periods)}"


def verdict_html(found: Any | None) -> str:
    """The verdict with its reasons; None while it is being found."""
    if found is None:
        return '<div class="soft">Verdict: being found …</div>'
    P_d = float(found.P_d[-1]) if getattr(found, "P_d", None) is not None and len(found.P_d) else None
    power = f" P_d = {P_d:.2f} %." if P_d is not None else ""
    return f"<div><b>{escape(str(found.verdict))}</b>.{power}</div>{note_html(str(found.evidence))}"
