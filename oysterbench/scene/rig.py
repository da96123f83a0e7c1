"""Where a rig's cameras sit in base_link, and how a camera projects."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array, transform
from oysterbench.recipe import CameraRecipe
from oysterbench.recipe.lens import half_in_air

R_FORWARD_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from an optical frame (z forward, x right, y down) to x forward, y left, z up (REP 103)."""


def camera_pose(recipe: CameraRecipe) -> Array:
    """Pose T_base_cam (4, 4) of the camera's optical frame in base_link."""
    mount = Rotation.from_euler("ZY", [recipe.yaw_deg, recipe.pitch_deg], degrees=True).as_matrix()
    return transform(mount @ R_FORWARD_OPTICAL, recipe.position_m)


def camera_matrix(recipe: CameraRecipe) -> Array:
    """Pinhole matrix (3, 3) in px; the centre of the first pixel is at (0, 0). Behind a flat port: the matrix in air.

    Half the image width spans half of hfov_deg, for a Brown-Conrady lens before distortion. Raises RecipeError when
    the field of view is too wide for a flat port, or when a fisheye's coefficients turn the image inside out.
    """
    half = half_in_air(recipe)
    extent = np.tan(half)
    if recipe.lens == "fisheye":
        powers = half ** np.arange(2, 2 * len(recipe.distortion) + 1, 2)
        extent = half * (1.0 + float(np.dot(recipe.distortion, powers)))
        if extent <= 0:
            raise RecipeError(
                f"camera {recipe.name}: key 'camera.distortion': expected coefficients that keep the image's edge "
                f"outside its centre, got {list(recipe.distortion)}"
            )
    focal = np.round(recipe.width / 2 / extent, 9)
    return np.array([[focal, 0.0, (recipe.width - 1) / 2], [0.0, focal, (recipe.height - 1) / 2], [0.0, 0.0, 1.0]])
