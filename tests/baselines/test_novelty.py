"""How unlike pictures are to those that a network has learnt from."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.annotations import Entry
from oysterbench_baselines.learning.novelty import Novelty, clips_of, learnt

SIZE = 60


def pictures(seed: int, clips: int, each: int, spread: float = 1.0) -> tuple[np.ndarray, list[str]]:
    """Features (N, SIZE) of clips that differ from each other as pictures do among themselves; few of them vary."""
    rng = np.random.default_rng(seed)
    scale = np.linspace(3, 0.1, SIZE)
    middles = rng.normal(0, spread, (clips, 1, SIZE))
    found = (middles + rng.normal(0, 0.5, (clips, each, SIZE))) * scale
    return found.reshape(-1, SIZE), [f"clip-{k}" for k in range(clips) for _ in range(each)]


def test_another_clip_of_the_same_kind_is_hardly_ever_called_novel_and_another_kind_is():
    # Fewer pictures than features squared, as in any training: the covariance has to be shrunk.
    alike, clips = pictures(0, 30, 4)
    novelty = learnt(alike, clips)
    others, _ = pictures(1, 50, 4)
    assert (novelty.of(others) > 1).mean() < 0.05
    unlike, _ = pictures(2, 10, 4, spread=5.0)
    assert (novelty.of(unlike) > 1).mean() > 0.95


def test_it_is_measured_by_clips_left_out_as_neighbouring_pictures_say_little_of_others():
    alike, clips = pictures(3, 12, 10)
    by_clip = learnt(alike, clips)
    by_picture = learnt(alike, [str(k) for k in range(len(clips))])
    assert by_clip.limit > by_picture.limit


def test_a_feature_that_never_varied_tells_when_it_does():
    alike, clips = pictures(4, 20, 5)
    alike[:, 7] = 2.0
    novelty = learnt(alike, clips)
    changed = alike[:1].copy()
    changed[0, 7] += 1
    assert np.isfinite(novelty.of(alike)).all()
    assert novelty.of(changed) > 2 * novelty.of(alike[:1])


@pytest.mark.parametrize(("clips", "each"), [(1, 30), (1, 2), (2, 1)])
def test_one_clip_alone_is_left_out_in_parts(clips, each):
    alike, names = pictures(5, clips, each)
    assert np.isfinite(learnt(alike, names).of(alike)).all()


def entries_of(clips: list[str], known: bool) -> list[Entry]:
    names = [f"f{k:04}" for k in range(len(clips))]
    return [
        Entry(name, clip if known else name, lambda: pytest.fail("it was read"), ())
        for name, clip in zip(names, clips, strict=True)
    ]


def test_where_no_clips_are_known_neighbours_are_left_out_together():
    """Or each would be measured against its neighbours, and all of another dive would be called novel."""
    alike, clips = pictures(7, 20, 30, spread=3.0)
    known, alone = (learnt(alike, clips_of(entries_of(clips, known))) for known in (True, False))
    assert known.limit == learnt(alike, clips).limit
    assert alone.limit == pytest.approx(known.limit, rel=0.1)
    others, _ = pictures(8, 20, 30, spread=3.0)
    assert (alone.of(others) > 1).mean() < 0.1


def test_what_is_left_out_follows_names_and_folders_not_the_order_of_reading():
    names = [f"a/{k:02}" for k in range(40)]
    mixed = [Entry(name, name, lambda: pytest.fail("it was read"), ()) for name in reversed(names)]
    parts = clips_of([*mixed, Entry("b/0", "b", lambda: pytest.fail("it was read"), ())])
    assert len(set(parts)) == 20
    assert parts[:40] == sorted(parts[:40], key=parts.index)
    assert parts[0] == parts[1] != parts[-1]


def test_it_is_kept_as_plain_tensors():
    alike, clips = pictures(6, 10, 5)
    novelty = learnt(alike, clips)
    again = Novelty.read(novelty.state())
    assert again.of(alike) == pytest.approx(novelty.of(alike), rel=1e-4)
