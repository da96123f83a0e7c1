"""Metrics of policies that explore: name, unit, direction and definition of each."""

from __future__ import annotations

import math

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics, counted, higher, lower, neutral

PER_MIN = "per min"


def _axis(axis: str, sides: str) -> dict[str, Metric]:
    """Metrics of one axis of the command."""
    name = axis.capitalize()
    return {
        f"{axis}_accuracy": higher(f"{name} right", column=Column(axis, "% right", 1, factor=100.0))(
            f"Share (0 to 1) of the images whose class of {axis} is the expert's."
        ),
        f"{axis}_balanced_accuracy": higher(f"{name} balanced")(
            f"Recall averaged over the classes of {axis} that the expert commands anywhere: classes count equally, "
            "however often they occur."
        ),
        f"{axis}_macro_f1": higher(f"{name} F1", column=Column(axis, "F1"))(
            f"Mean of F1 over the classes of {axis}; a class that neither the expert nor the policy ever commands is "
            "left out, one that only one of them commands counts 0."
        ),
        f"{axis}_within_one": higher(f"{name} within one")(
            f"Share (0 to 1) of the images whose class of {axis} is the expert's or adjacent to it."
        ),
        f"{axis}_cost_classes": lower(f"{name} cost", "classes")(
            f"Expected cost: mean over images of the distance to the expert's class of {axis}, {sides}, each class "
            "weighted by its probability; a policy that only names a class gives it probability 1."
        ),
        f"{axis}_cost_deg": lower(f"{name} cost", "deg", Column(axis, "deg off", 1))(
            f"The same cost of {axis} in degrees of the task's turns."
        ),
    }


PICTURES: dict[str, Metric] = {
    "skill": higher("Skill", column=Column("skill"), limits=(-math.inf, 1.0))(
        "1 - regret / regret of commands drawn evenly from all pairs of classes, over the images of a sequence: 1 for "
        "the expert's own commands, 0 for chance, below 0 if worse than chance. If several commands are equally good, "
        "any of them is right. A failed run counts as the worst command at each image."
    ),
    "regret_oysters": lower("Regret", "oysters", Column("regret", "oysters", 2))(
        "Mean over images of the value of the expert's best pair of classes minus that of the commanded pair: oysters "
        "lost per decision, by the expert's own plans, in which leaving the altitude band and contacts cost oysters."
    ),
    **_axis("yaw", "ordered from left to right"),
    **_axis("pitch", "ordered from up to down"),
    "joint_accuracy": higher("Both right")("Share (0 to 1) of the images in which both classes are the expert's."),
    "pictures": counted("Images")("Number of images with a command."),
    "pictures_per_s": higher("Speed", "per s")("Images processed per wall time of the policy."),
}
"""Metrics of the steering track, over labelled images, by their key."""

ROLLOUTS: dict[str, Metric] = {
    "oysters_per_min": higher("Oysters", PER_MIN, Column("oysters", "per min", 1))(
        "Live oysters of the rollout's area that were seen, each counted once, per minute of the rollout, including "
        "those in the first view. An oyster is seen when it is near enough for the water and large enough in the "
        "image, by the task's limits. A failed rollout counts 0."
    ),
    "oysters_seen": higher("Seen", limits=(0.0, math.inf))("Those oysters."),
    "found_share": higher("Found", column=Column("found", "%", 1, factor=100.0))(
        "Those oysters as a share (0 to 1) of all live ones in the area: what can be found in a rollout."
    ),
    "covered_share": higher("Covered", column=Column("covered", "%", 1, factor=100.0))(
        "Share (0 to 1) of the bottom within the fence that was seen from close enough: of squares of 25 cm, those of "
        "which a part was."
    ),
    "contacts": lower("Contacts")(
        "Number of times the hull would have touched something and was held above it; consecutive steps count once."
    ),
    "contacts_per_min": lower("Contacts", PER_MIN, Column("contacts", "per min", 2))(
        "The same per minute of the rollout."
    ),
    "contact_share": lower("In contact")("Share (0 to 1) of the steps with a contact."),
    "in_band_share": higher("Band", column=Column("in band", "%", 1, factor=100.0))(
        "Share (0 to 1) of the commands after which the altitude is in the task's band."
    ),
    "turned_back": lower("Turned", column=Column("turned", "times", 1))(
        "Number of times the fence turned the vehicle; consecutive steps count once."
    ),
    "distance_m": neutral("Path", "m", Column("path", "m", 1))("Length of the path, as chords from step to step."),
    "oysters_per_m": higher("Oysters", "per m")("Oysters seen per length of path."),
    "steps_per_s": higher("Steps", "per s", Column("speed", "steps/s", 1))(
        "Commands per wall time of the rollout: steering, moving and, for a policy, rendering its views; the "
        "references get no images."
    ),
    "rollout_s": neutral("Rollout", "s")("Length of the rollout."),
}
"""Metrics of a rollout in a closed loop by their key."""

TABLE = (
    "skill",
    "regret_oysters",
    *(f"{axis}_{what}" for axis in ("yaw", "pitch") for what in ("accuracy", "macro_f1", "cost_deg")),
)
STEERING = TrackMetrics(
    "Steering",
    PICTURES,
    TABLE,
    TABLE[1:],
    beside="regret_oysters",
    failed={"skill": 0.0},
    failed_as="scores as the worst command at each image",
)

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
    "Exploration",
    ROLLOUTS,
    EXPLORATION_TABLE,
    tuple(key for key in EXPLORATION_TABLE[1:] if key != "distance_m"),  # no merit, and nearly the same for all
    beside="contacts_per_min",
    failed={"oysters_per_min": 0.0},
)
