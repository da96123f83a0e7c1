"""A split according to its recipe: its sequences, their conditions, and the cost of rendering them."""

from __future__ import annotations

from oysterbench.evaluate.conditions import CONDITIONS
from oysterbench.recipe import SplitRecipe
from oysterbench.report.table import Column, Table, TableRow
from oysterbench.simulation import cost
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import split_folder

SHOWN = ("difficulty", "disturbance", "strength", "water_type", "secchi_m", "light", "motion", "duration_s")
HOUR_S = 3600.0
NUMBERS = ("difficulty", "strength", "secchi_m", "duration_s")


def sequences_table(split: SplitRecipe) -> Table:
    """Table with a row for each sequence; conditions that no sequence states have no column."""
    like = {sequence.name: conditions(split, sequence.name) for sequence in split.sequence}
    shown = [key for key in SHOWN if any(key in values for values in like.values())]
    measured = cost.measured(split_folder(split))
    columns = [Column("sequence", "Sequence")]
    for i, key in enumerate(shown):
        about = CONDITIONS[key]
        heading = about.name[:1].upper() + about.name[1:]
        columns.append(Column(key, heading, about.unit, "number" if key in NUMBERS else "text", wide=i > 1))
    columns += [
        Column("cpu_estimated_s", "Estimated", "CPU min", "number", digits=1, factor=1 / 60),
        Column("cpu_measured_s", "Measured", "CPU min", "number", digits=1, factor=1 / 60),
    ]
    rows = []
    total = 0.0
    for sequence in split.sequence:
        estimate = cost.estimated(split, sequence)
        total += estimate
        values = (like[sequence.name].get(key) for key in shown)
        rows.append(TableRow((sequence.name, *values, estimate, measured.get(sequence.name))))
    time = f"{total / HOUR_S:.1f} hours" if total >= HOUR_S else f"{total / 60:.1f} minutes"
    note = (
        f"Rendering all takes about {time} on one core of a 2.6 GHz server, shared by the workers; measured "
        "values are from this machine."
    )
    return Table(f"{split.name} {split.version}", tuple(columns), tuple(rows), (note,))
