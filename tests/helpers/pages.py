"""Pages as they are looked at: on a telephone, in the dark, and by axe-core."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from tests.helpers.axe import WHY_NOT, axe_file, violations
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


class LegiblePages:
    """Tests of the pages of a module's fixture `pages`, name -> address."""

    @pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
    def test_no_page_is_wider_than_a_telephone(self, browser, pages, dark):
        assert too_wide(browser, pages, dark=dark) == []

    @pytest.mark.skipif(axe_file() is None, reason=WHY_NOT)
    @pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
    def test_axe_finds_nothing_wrong(self, browser, pages, width, dark):
        assert faults(browser, pages, width, dark=dark) == {}
