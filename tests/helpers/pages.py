"""Pages as they are looked at: on a telephone, in the dark, and by axe-core."""

from __future__ import annotations

from collections.abc import Mapping

from tests.helpers.axe import violations
from tests.helpers.browser import Browser

TELEPHONE_PX = 390


def too_wide(browser: Browser, pages: Mapping[str, str], *, dark: bool) -> list[str]:
    """Names of the pages (name -> address) that have to be scrolled sideways on a telephone."""
    browser.look(TELEPHONE_PX, dark)
    found = []
    for name, address in pages.items():
        browser.go(address)
        root = "document.documentElement"
        if not browser.value(f"{root}.scrollWidth <= {root}.clientWidth"):
            found.append(name)
    return found


def faults(browser: Browser, pages: Mapping[str, str], width: int, *, dark: bool) -> dict[str, list[str]]:
    """What axe-core finds wrong, by the name of the page (name -> address)."""
    browser.look(width, dark)
    found = {}
    for name, address in pages.items():
        browser.go(address)
        if wrong := violations(browser):
            found[name] = wrong
    return found
