"""Names of categories: which are of oysters, and which may be."""

from __future__ import annotations

import pytest

from oysterbench.annotations.categories import categories_of, may_be_oysters


def of(*names, above=""):
    return categories_of([{"id": k, "name": name, "supercategory": above} for k, name in enumerate(names)])


@pytest.mark.parametrize("above", ["", "none", "object", "Objects", "default", "N/A", "undefined", "status", "label"])
def test_live_and_dead_alone_are_oysters_below_a_supercategory_that_says_nothing(above):
    assert of("live", "dead", above=above).states == {0: "live", 1: "dead"}


@pytest.mark.parametrize("names", [("LiveOyster", "DeadOyster"), ("oysterLive", "oysterDead"), ("liveOysters", "Dead")])
def test_words_that_are_joined_are_told_apart_by_their_capitals(names):
    assert of(*names).states == {0: "live", 1: "dead"}


@pytest.mark.parametrize("above", ["coral", "mussels", "barnacles"])
def test_live_and_dead_of_something_else_are_no_oysters(above):
    found = of("live", "dead", above=above)
    assert not found.states
    assert found.doubtful == {0, 1}


@pytest.mark.parametrize(
    "name", ["recently dead", "dying", "live_2", "dead1", "unsure", "unidentified", "oyster-shell", "deadoyster"]
)
def test_a_state_or_an_age_of_nothing_named_may_be_of_oysters(name):
    assert may_be_oysters(name)
    assert of("live oyster", "dead oyster", name).doubtful == {2}


@pytest.mark.parametrize("name", ["barnacle", "dead coral", "rock 2", "", "12", "live bottom"])
def test_a_name_of_something_else_is_of_no_oysters(name):
    assert not may_be_oysters(name)
    assert not of("oyster", name).doubtful


@pytest.mark.parametrize(
    "above", ["bivalve", "shellfish", "Crassostrea virginica", "life stage", "age", "condition", "other"]
)
@pytest.mark.parametrize("name", ["spat", "juvenile", "unknown"])
def test_the_ages_and_doubts_of_what_may_be_oysters_are_doubtful(name, above):
    """Such as those of a group that holds oysters, or of an age: they were left out without a word."""
    content = [{"id": 0, "name": "oyster", "supercategory": "reef"}, {"id": 1, "name": name, "supercategory": above}]
    assert categories_of(content).doubtful == {1}


@pytest.mark.parametrize(
    ("name", "above"), [("unknown", "fish"), ("juvenile", "crab"), ("unsure", "algae"), ("adults", "Reef fishes")]
)
def test_the_ages_and_doubts_of_something_else_are_of_no_oysters(name, above):
    content = [{"id": 0, "name": "oyster", "supercategory": "shell"}, {"id": 1, "name": name, "supercategory": above}]
    assert not categories_of(content).doubtful
    assert categories_of([content[0], {**content[1], "supercategory": "shell"}]).doubtful == {1}
