"""All that is known of a design, as one document."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxshroud.results import pages
from jaxshroud.results.attractors import Attractors
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.pages import Section
from jaxshroud.results.scatter import Scatter
from jaxshroud.results.sweep import SweepResult


@dataclass(frozen=True)
class Report:
    """A design judged: the verdict with its reasons, and the results that it rests on."""

    title: str
    verdict: str  # "sound", "doubtful" or "fails"
    reasons: tuple[str, ...]
    run: SweepResult  # the design itself, with its largest forces and energy balance
    over_gap: SweepResult
    scatter: Scatter | None
    gradient: Gradient
    attractors: Attractors
    sections: Sequence[Section]

    def save(self, path: str | Path) -> None:
        """Write the document: .html or .pdf.

        Raises:
            InputError: The suffix is another one.
            WriteError: The place cannot be written.
        """
        pages.save(self.title, self.sections, Path(path))

    def __repr__(self) -> str:
        return f"Report: {self.verdict}; {'; '.join(self.reasons)}"
