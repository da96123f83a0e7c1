"""Statistics of an image that tell water and texture apart: colour, contrast, gradients, power spectrum."""

from __future__ import annotations

import cv2
import numpy as np

SIDE = 256


def image_statistics(pixels: np.ndarray) -> dict[str, float]:
    """Statistics of an (H, W, 3) uint8 RGB image, after taking its central square to SIDE x SIDE.

    L, a, b: mean CIELAB. contrast: standard deviation of L. chroma_spread: standard deviation of a and b together.
    gradient: mean magnitude of the gradient of L, per pixel. gradient_kurtosis: heaviness of its tails.
    slope: exponent p of the radially averaged power spectrum ~ f^-p between 4 and 64 cycles per image.
    """
    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = cv2.resize(pixels[top : top + side, left : left + side], (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(square.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)
    light = lab[..., 0].astype(float)
    dy, dx = np.gradient(light)
    both = np.concatenate([dx.ravel(), dy.ravel()])
    return {
        "L": float(light.mean()),
        "a": float(lab[..., 1].mean()),
        "b": float(lab[..., 2].mean()),
        "contrast": float(light.std()),
        "chroma_spread": float(np.hypot(lab[..., 1].std(), lab[..., 2].std())),
        "gradient": float(np.hypot(dx, dy).mean()),
        "gradient_kurtosis": float(np.mean(both**4) / np.mean(both**2) ** 2),
        "slope": spectral_slope(light),
    }


def spectral_slope(light: np.ndarray) -> float:
    """Exponent p of power ~ f^-p, fitted in logarithms over rings from 4 to 64 cycles per image (Hann window)."""
    window = np.outer(np.hanning(SIDE), np.hanning(SIDE))
    power = np.abs(np.fft.fftshift(np.fft.fft2((light - light.mean()) * window))) ** 2
    y, x = np.indices(power.shape) - SIDE // 2
    radius = np.hypot(x, y).astype(int)
    rings = np.arange(4, 65)
    mean = np.array([power[radius == ring].mean() for ring in rings])
    return float(-np.polyfit(np.log(rings), np.log(mean), 1)[0])
