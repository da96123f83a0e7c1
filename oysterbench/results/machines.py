"""Machines that results were measured on: speeds from different machines do not compare methods."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from oysterbench.evaluate.metrics import TIMES
from oysterbench.results.records import ResultRecord


def machine_of(hardware: Mapping[str, Any]) -> str:
    """Processor and number of cores in a few words; empty if the processor is unknown.

    >>> machine_of({"cpu": "AMD EPYC", "cores": 2, "python": "3.11"})
    'AMD EPYC, 2 cores'
    """
    cpu, cores = hardware.get("cpu"), hardware.get("cores")
    if not cpu:
        return ""
    return f"{cpu}, {cores} core{'' if cores == 1 else 's'}" if cores else str(cpu)


def machines_of(records: Iterable[ResultRecord]) -> dict[str, list[str]]:
    """Machine -> methods whose speed was measured on it, both in the order of the records."""
    found: dict[str, list[str]] = {}
    for record in records:
        machine = machine_of(record.hardware)
        if machine and record.failure is None and any(key in record.metrics for key in TIMES):
            methods = found.setdefault(machine, [])
            methods += [record.method] if record.method not in methods else []
    return found


def machines_note(records: Iterable[ResultRecord]) -> str:
    """Warning for speeds measured on several machines; else empty."""
    found = machines_of(records)
    if len(found) < 2:
        return ""
    places = "; ".join(f"{', '.join(methods)} on {machine}" for machine, methods in found.items())
    return f"speeds are of different machines and do not compare methods: {places}"
