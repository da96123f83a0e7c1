"""Diagnosis of this machine: what is installed, missing or set, whether it works, and what to type."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from oysterbench.notebook.doctor.data import look_at_data, look_at_hub, look_at_systems
from oysterbench.notebook.doctor.finding import Finding
from oysterbench.notebook.doctor.installed import look_at_packages
from oysterbench.notebook.doctor.machine import look_at_containment, look_at_machine

__all__ = ["Checkup", "Finding", "doctor"]


@dataclass(frozen=True, repr=False)
class Checkup:
    """Result of a diagnosis, section by section; `broken` lists what is set or installed and does not work."""

    findings: tuple[Finding, ...]

    @property
    def broken(self) -> tuple[Finding, ...]:
        """Findings of what is set or installed, and does not work."""
        return tuple(one for one in self.findings if one.state == "broken")

    def sections(self) -> Iterator[tuple[str, list[Finding]]]:
        """Yield the name of each section, and its findings."""
        for section, findings in groupby(self.findings, lambda one: one.section):
            yield section, list(findings)

    def __repr__(self) -> str:
        lines = []
        for section, findings in self.sections():
            lines.append(section)
            for one in findings:
                advice = f"; {one.advice}" if one.advice else ""
                lines.append(f"  {one.state:<8}{one.name}: {one.detail}{advice}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from oysterbench.core.display import CardTable, card

        rows = [(one.section, one.name, one.state, one.detail, one.advice) for one in self.findings]
        lead = f"{len(self.broken)} broken" if self.broken else "nothing is broken"
        return card("oysterbench doctor", lead, [CardTable(("", "what", "state", "", "to type or to do"), rows)])


def doctor() -> Checkup:
    """Check what is installed, the machine, and what is set. No network is used, and nothing is changed.

    Returns
    -------
    Checkup
        Displays itself; ``findings`` has one entry for each thing, ``broken`` those that are set and do not work.

    Examples
    --------
    >>> import oysterbench
    >>> checkup = oysterbench.doctor()
    >>> [one.name for one in checkup.findings][:2]
    ['oysterbench', 'packages']
    """
    looks = (look_at_packages, look_at_machine, look_at_data, look_at_hub, look_at_systems, look_at_containment)
    return Checkup(tuple(finding for look in looks for finding in look()))
