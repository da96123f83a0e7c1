"""Registry of the sensor kinds in this package, and what follows from them for rigs and calibrations."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Any

from oysterbench.core.streams import Streams
from oysterbench.recipe import RigRecipe, SiteRecipe
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.kind import Export, SensorKind
from oysterbench.sensors.uncertainty import (
    QUALITIES,
    UNCERTAINTY,
    RigCalibration,
    draw_errors,
    errors_of,
    joined,
    uncertainty_of,
)

AnyKind = SensorKind[Any, Any, Any]

FIRST_CALIBRATED = ("imu", "camera", "sonar", "scanner", "altimeter")
"""Blocks that come first in calibration.json, whose bytes depend on the order; the others follow by rank."""


@cache
def sensor_kinds() -> Mapping[str, AnyKind]:
    """Block -> kind, for all modules of this package that define `KIND`, by rank."""
    package = import_module("oysterbench.sensors")
    modules = (import_module(f"{package.__name__}.{info.name}") for info in pkgutil.iter_modules(package.__path__))
    kinds: list[AnyKind] = [module.KIND for module in modules if hasattr(module, "KIND")]
    return {kind.block: kind for kind in sorted(kinds, key=lambda kind: (kind.rank, kind.block))}


@cache
def calibrated_kinds() -> tuple[AnyKind, ...]:
    """All kinds, in the order of calibration.json."""
    kinds = sensor_kinds()
    return tuple(kinds[block] for block in dict.fromkeys((*FIRST_CALIBRATED, *kinds)))


def kind_of(recipe: SensorRecipe) -> AnyKind:
    """Kind of a sensor."""
    return sensor_kinds()[recipe.block]


def rig_sensors(rig: RigRecipe) -> Iterator[tuple[AnyKind, Any]]:
    """Yield kind and recipe of each sensor of a rig, by the rank of the kinds."""
    for kind in sensor_kinds().values():
        for recipe in rig.of(kind.recipe):
            yield kind, recipe


def rig_calibration(rig: RigRecipe, site: SiteRecipe) -> dict[str, Any]:
    """Content of calibration.json for a rig at a site, as JSON values: what a perfect calibration would find. Sensors
    that the rig lacks are absent."""
    return _document(rig, lambda kind, recipe: kind.calibrate(recipe, site))


def _document(rig: RigRecipe, entry: Callable[[AnyKind, Any], dict[str, Any]]) -> dict[str, Any]:
    document: dict[str, Any] = {}
    for kind in calibrated_kinds():
        entries = {kind.name_of(recipe): entry(kind, recipe) for recipe in rig.of(kind.recipe)}
        if entries or kind.required:
            document[kind.key] = entries[kind.block] if kind.single else entries
    return document


def calibrate_rig(rig: RigRecipe, site: SiteRecipe, quality: str, streams: Streams) -> RigCalibration:
    """Given and true calibration of a rig at a site. quality: "exact", or one of QUALITIES.

    The errors are drawn from the covariance that the given calibration states; streams: those of the sequence.
    """
    true = _document(rig, lambda kind, recipe: kind.true_calibration(recipe, site))
    if quality not in QUALITIES:
        return RigCalibration(rig_calibration(rig, site), true, {})
    sizes = QUALITIES[quality]
    sensors = [(kind, recipe) for kind in calibrated_kinds() for recipe in rig.of(kind.recipe)]
    model = joined(
        {
            kind.name_of(recipe): kind.error_model(recipe, kind.calibrate(recipe, site), sizes)
            for kind, recipe in sensors
        }
    )
    errors = draw_errors(model, streams.at("calibration"))

    def of(kind: AnyKind, recipe: Any) -> dict[str, float]:
        return errors_of(errors, kind.name_of(recipe), kind.key)

    given = _document(
        rig,
        lambda kind, recipe: kind.as_given(recipe, kind.calibrate(recipe, site), of(kind, recipe), sizes),
    )
    true = _document(
        rig,
        lambda kind, recipe: kind.as_true(recipe, kind.true_calibration(recipe, site), of(kind, recipe), sizes),
    )
    return RigCalibration({**given, UNCERTAINTY: uncertainty_of(model).as_entry()}, true, errors)


def read_calibrations(document: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Block -> name -> calibration, from calibration.json, for the kinds that it contains.

    Raises LookupError, TypeError or ValueError where the document is malformed.
    """
    found: dict[str, dict[str, Any]] = {}
    for kind in calibrated_kinds():
        entries: Any = document[kind.key] if kind.required else document.get(kind.key)
        if entries or kind.required:
            by_name: Mapping[str, Any] = {kind.block: entries} if kind.single else entries
            found[kind.block] = {name: kind.read_calibration(entry) for name, entry in by_name.items()}
    return found


def rig_frames(rig: RigRecipe) -> dict[str, tuple[AnyKind, str]]:
    """Frame -> kind and name of the sensor that it belongs to, for `/tf_static`."""
    ranked = sorted(calibrated_kinds(), key=lambda kind: (not kind.single, kind.rank if kind.single else 0))
    names = ((kind, kind.name_of(recipe)) for kind in ranked for recipe in rig.of(kind.recipe))
    return {kind.frame(name): (kind, name) for kind, name in names}


def export_formats() -> dict[str, tuple[AnyKind, Export]]:
    """Export format -> the sensor kind that it belongs to, and how it is written."""
    return {form: (kind, export) for kind in sensor_kinds().values() for form, export in kind.exports.items()}
