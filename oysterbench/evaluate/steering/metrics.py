"""What is measured of policies that explore: name, unit, direction and definition of every metric."""

from __future__ import annotations

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics

PER_MIN = "per min"


def _axis(axis: str, sides: str) -> dict[str, Metric]:
    """Metrics of one axis of the command."""
    name = axis.capitalize()
    return {
        f"{axis}_accuracy": Metric(
            f"Share (0 to 1) of the pictures whose class of {axis} is the expert's.",
            f"{name} right",
            better="higher",
            column=Column(axis, "% right", digits=1, small=0.0, factor=100.0),
        ),
        f"{axis}_balanced_accuracy": Metric(
            f"Mean over the classes of {axis} that the expert commands somewhere of the share of their pictures in "
            "which they are commanded: classes count alike however often they occur.",
            f"{name} balanced",
            better="higher",
        ),
        f"{axis}_macro_f1": Metric(
            f"Mean of F1 over the classes of {axis}; one that neither the expert nor the policy commands in any "
            "picture is left out, one that only one of them commands counts 0.",
            f"{name} F1",
            better="higher",
            column=Column(axis, "F1", small=0.0),
        ),
        f"{axis}_within_one": Metric(
            f"Share (0 to 1) of the pictures whose class of {axis} is the expert's or one next to it.",
            f"{name} within one",
            better="higher",
        ),
        f"{axis}_cost_classes": Metric(
            f"Expected cost: mean over pictures of the distance to the expert's class of {axis}, {sides}, each class "
            "weighed by its probability; a policy that only says which class gives it all of it.",
            f"{name} cost",
            unit="classes",
            better="lower",
        ),
        f"{axis}_cost_deg": Metric(
            f"The same cost of {axis} in degrees of the task's turns.",
            f"{name} cost",
            unit="deg",
            better="lower",
            column=Column(axis, "deg off", digits=1, small=0.0),
        ),
    }


PICTURES: dict[str, Metric] = {
    "skill": Metric(
        "1 - regret / regret of commands drawn evenly from all pairs of classes, over all pictures: 1 of the expert's "
        "own commands, 0 of chance, below 0 of what is worse than chance. Where several commands are as good, any of "
        "them is right. A failed run counts 0.",
        "Skill",
        better="higher",
        column=Column("skill", "", small=0.0),
    ),
    "regret_oysters": Metric(
        "Mean over pictures of the value of the expert's best pair of classes less that of the commanded pair: oysters "
        "lost per decision, by the expert's own plans, in which leaving the altitude band and touching cost oysters.",
        "Regret",
        unit="oysters",
        better="lower",
        column=Column("regret", "oysters", digits=2, small=0.0),
    ),
    **_axis("yaw", "which lie from left to right"),
    **_axis("pitch", "which lie from up to down"),
    "joint_accuracy": Metric(
        "Share (0 to 1) of the pictures in which both classes are the expert's.", "Both right", better="higher"
    ),
    "pictures": Metric("Number of pictures that were answered.", "Pictures"),
    "pictures_per_s": Metric(
        "Pictures answered by the wall time of the policy.", "Speed", unit="per s", better="higher"
    ),
}
"""Metrics of the track steering, over labelled pictures, by their key."""

ROLLOUTS: dict[str, Metric] = {
    "oysters_per_min": Metric(
        "Live oysters of the rollout's area that were seen, each once, by the length of the rollout; those in the "
        "first view included. An oyster is seen when it is near enough for the water, and large enough in the picture, "
        "for the task's limits. A failed rollout counts 0.",
        "Oysters",
        unit=PER_MIN,
        better="higher",
        column=Column("oysters", "per min", digits=1, small=0.0),
    ),
    "oysters_seen": Metric("Those oysters.", "Seen", better="higher"),
    "found_share": Metric(
        "Those oysters by all live ones of the area (0 to 1): what can be found in a rollout.",
        "Found",
        better="higher",
        column=Column("found", "%", digits=1, small=0.0, factor=100.0),
    ),
    "covered_share": Metric(
        "Share (0 to 1) of the bottom within the fence that was seen from near enough.",
        "Covered",
        better="higher",
        column=Column("covered", "%", digits=1, small=0.0, factor=100.0),
    ),
    "contacts": Metric(
        "Times that the hull would have touched something and was held above it: steps in a row count once.",
        "Contacts",
        better="lower",
    ),
    "contacts_per_min": Metric(
        "The same by the length of the rollout.",
        "Contacts",
        unit=PER_MIN,
        better="lower",
        column=Column("contacts", "per min", digits=2, small=0.0),
    ),
    "contact_share": Metric("Share (0 to 1) of the steps with a contact.", "In contact", better="lower"),
    "in_band_share": Metric(
        "Share (0 to 1) of the commands after which the altitude is in the task's band.",
        "Band",
        better="higher",
        column=Column("in band", "%", digits=1, small=0.0, factor=100.0),
    ),
    "turned_back": Metric(
        "Times that the fence turned the vehicle: steps in a row count once.",
        "Turned",
        better="lower",
        column=Column("turned", "times", digits=1, small=0.0),
    ),
    "distance_m": Metric(
        "Length of the path, in chords from step to step.",
        "Path",
        unit="m",
        column=Column("path", "m", digits=1, small=0.0),
    ),
    "oysters_per_m": Metric("Oysters seen by that length.", "Oysters", unit="per m", better="higher"),
    "steps_per_s": Metric(
        "Commands by the wall time of the rollout: steering, moving, and, for a policy, rendering what it sees; the "
        "references are shown no picture.",
        "Steps",
        unit="per s",
        better="higher",
        column=Column("speed", "steps/s", digits=1, small=0.0),
    ),
    "dive_s": Metric("Length of the rollout.", "Rollout", unit="s"),
}
"""Metrics of a rollout in a closed loop by their key."""

TABLE = (
    "skill",
    "regret_oysters",
    *(f"{axis}_{what}" for axis in ("yaw", "pitch") for what in ("accuracy", "macro_f1", "cost_deg")),
)
STEERING = TrackMetrics(PICTURES, TABLE, TABLE[1:], beside="regret_oysters", failed={"skill": 0.0})

EXPLORATION_TABLE = (
    "oysters_per_min",
    "found_share",
    "covered_share",
    "contacts_per_min",
    "in_band_share",
    "turned_back",
    "distance_m",
    "steps_per_s",
)
EXPLORATION = TrackMetrics(
    ROLLOUTS, EXPLORATION_TABLE, EXPLORATION_TABLE[1:], beside="contacts_per_min", failed={"oysters_per_min": 0.0}
)
