"""Size of the smallest oyster that counts: a smaller detection is a speck."""

from __future__ import annotations

from dataclasses import dataclass

from oysterbench.annotations.parts import SHORTEST_MM, speck_px


@dataclass(frozen=True)
class Least:
    """Minimum size of an oyster. length_mm: longer side of the smallest rectangle around it; area_px: of its mask, or
    its box. 0 means no minimum; None means the default, which applies only to connected parts of a mask: a method that
    separates oysters is trusted to discard specks as well."""

    length_mm: float | None = None
    area_px: float | None = None

    def for_image(self, shape: tuple[int, int], parts: bool, scaled: bool) -> tuple[float, float]:
        """Minimum length in mm and area in px of an oyster in an image (H, W); parts: whether oysters are connected
        parts of a mask; scaled: whether lengths are known there.

        >>> Least().for_image((480, 640), parts=True, scaled=True)
        (25.0, 0.0)
        >>> [round(value, 1) for value in Least().for_image((480, 640), parts=True, scaled=False)]
        [0.0, 49.2]
        """
        if self.length_mm is not None or self.area_px is not None or not parts:
            return self.length_mm or 0.0, self.area_px or 0.0
        return (SHORTEST_MM, 0.0) if scaled else (0.0, speck_px(shape))

    def as_dict(self) -> dict[str, float | None]:
        """Return the settings as a dict, for records."""
        return {"length_mm": self.length_mm, "area_px": self.area_px}

    def described(self, parts: bool, scaled: bool) -> str:
        """Describe the minimum size in words; empty if there is none."""
        length_mm, area_px = self.for_image((0, 640), parts, scaled)
        by_size = " in an image of 640 px, scaled with the image" if self.area_px is None else ""
        said = [f"{length_mm:g} mm long"] * (length_mm > 0) + [f"{area_px:.0f} px{by_size}"] * (area_px > 0)
        return " and ".join(said)


EVERY_SIZE = Least(0.0, 0.0)
