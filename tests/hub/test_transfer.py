"""Files fetched in pieces, from servers of all kinds: the right bytes or a clear error, never a wrong file."""

from __future__ import annotations

import errno
import os
import random
from dataclasses import replace
from itertools import pairwise

import pytest

from oysterbench.core.errors import HubError, IntegrityError, NetworkError
from oysterbench.hub.part import Part
from oysterbench.hub.sources import Absence, open_source, retry_after_s
from oysterbench.hub.transfer import Mirror, pause_s
from tests.helpers.blobs import CALM, IMPATIENT, beginnings, blob, fetch
from tests.helpers.web import KINDS, Honest, misbehaving, serving

DATA, ENTRY = blob(300_001)
PATH = f"blobs/{ENTRY.sha256}"


def attempt(kind, seed, folder):
    """One run against a server that misbehaves for a random share of its answers; True if the file came."""
    generator = random.Random(seed)
    share = generator.choice((0.2, 0.5, 0.9, 1.0))
    target = folder / f"{kind}-{seed}.mcap"
    with misbehaving(kind, {PATH: DATA}, seed, share) as site:
        failure = None
        try:
            fetch(ENTRY, target, [site.url], IMPATIENT, connections=generator.choice((1, 3, 4)))
        except HubError as error:
            failure = error
    if failure is not None:
        assert not target.exists()
        assert failure.exit_code in (3, 4)
        part = target.with_suffix(".part")
        lacks = "status 404" in str(failure) and not right_pieces(part)
        assert ("does the hub have it?" if lacks else "the same command resumes from there") in str(failure)
        assert site.url in str(failure)
        # What was kept is right: an honest server gives the rest, and the beginnings again that the bad one faked.
        rest = len(DATA) - sum(ENTRY.length(piece) for piece in right_pieces(part))
        begun, faked = beginnings(part, ENTRY, DATA)
        with serving(Honest, {PATH: DATA}) as honest:
            fetch(ENTRY, target, [honest.url])
            asked = sum(end - start for _, start, end in honest.requests)
        assert asked == rest - begun if not faked else asked > rest - begun
    assert target.read_bytes() == DATA
    return failure is None


def right_pieces(path):
    part = Part(path, ENTRY)
    found = [piece for piece in range(len(ENTRY.pieces)) if part.is_right(piece)]
    part.close()
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_misbehaving_server_gives_the_right_bytes_or_a_clear_error(kind, tmp_path):
    for seed in range(4):
        attempt(kind, seed, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_misbehaving_server_200_times(kind, tmp_path):
    came = sum(attempt(kind, 1000 + seed, tmp_path) for seed in range(200))
    print(f"{kind}: {came} of 200 came whole, the others ended in an error and came from the next server")


@pytest.mark.parametrize("size", [1, 5, 1 << 14, (1 << 14) + 1, 200_000])
def test_files_of_every_size_come_whole(size, tmp_path):
    data, entry = blob(size, seed=size)
    with serving(Honest, {f"blobs/{entry.sha256}": data}) as site:
        fetch(entry, tmp_path / "file", [site.url])
    assert (tmp_path / "file").read_bytes() == data
    assert not (tmp_path / "file.part").exists()
    assert site.sent == size


def test_each_piece_is_asked_for_once(tmp_path):
    with serving(Honest, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url])
    asked = sorted((start, end) for _, start, end in site.requests)
    assert asked[0][0] == 0
    assert asked[-1][1] == len(DATA)
    assert all(end == start for (_, end), (start, _) in pairwise(asked))


def test_a_part_is_gone_on_with_and_its_damaged_pieces_are_fetched_again(tmp_path):
    damaged = bytearray(DATA)
    damaged[5 * ENTRY.piece_size + 7] ^= 1
    damaged[-1] ^= 1
    (tmp_path / "file.part").write_bytes(damaged)
    with serving(Honest, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url])
    assert (tmp_path / "file").read_bytes() == DATA
    last = len(ENTRY.pieces) - 1
    assert sorted((start, end) for _, start, end in site.requests) == [ENTRY.span(5), ENTRY.span(last)]


def test_a_part_of_another_length_is_no_harm(tmp_path):
    (tmp_path / "file.part").write_bytes(DATA + b"more")
    with serving(Honest, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url])
    assert site.requests == []
    assert (tmp_path / "file").read_bytes() == DATA


def test_a_cut_connection_goes_on_within_the_piece(tmp_path):
    with misbehaving("cut", {PATH: DATA}, 3, 0.5) as site:
        fetch(ENTRY, tmp_path / "file", [site.url], connections=1)
    assert any(start % ENTRY.piece_size for _, start, _ in site.requests)
    assert (tmp_path / "file").read_bytes() == DATA


def test_a_mirror_that_failed_for_another_reason_does_not_lack_the_file():
    mirror = Mirror(open_source("http://127.0.0.1:9", 1, CALM))
    assert not mirror.lacks(PATH)
    mirror.refused[PATH] = Absence("status 404")
    assert mirror.lacks(PATH)
    mirror.fail("no answer, 4 times in a row")  # to another connection, at the same time
    assert not mirror.lacks(PATH)
    assert mirror.why_not(PATH) == "no answer, 4 times in a row"


def test_mirrors_stand_in_for_one_another(tmp_path):
    with (
        misbehaving("wrong_bytes", {PATH: DATA}, 1, 1.0) as liar,
        serving(Honest, {}) as empty,
        serving(Honest, {PATH: DATA}) as honest,
    ):
        mirrors = fetch(ENTRY, tmp_path / "file", [liar.url, empty.url, "http://127.0.0.1:9", honest.url])
    assert (tmp_path / "file").read_bytes() == DATA
    assert mirrors[0].lied
    assert "404" in mirrors[1].why_not(PATH)
    assert mirrors[3].why_not(PATH) is None


def test_several_good_mirrors_share_the_work(tmp_path):
    with serving(Honest, {PATH: DATA}) as one, serving(Honest, {PATH: DATA}) as other:
        fetch(ENTRY, tmp_path / "file", [one.url, other.url], connections=2)
    assert one.sent + other.sent == len(DATA)


def test_wrong_bytes_are_an_integrity_error_and_a_dead_server_is_a_network_error(tmp_path):
    with misbehaving("wrong_file", {PATH: DATA}, 1, 1.0) as site, pytest.raises(IntegrityError, match="wrong bytes"):
        fetch(ENTRY, tmp_path / "file", [site.url])
    with pytest.raises(NetworkError, match=r"127.0.0.1:9: no answer.*4 times in a row"):
        fetch(ENTRY, tmp_path / "file", ["http://127.0.0.1:9"])


def test_a_server_that_ignores_ranges_is_read_once(tmp_path):
    whole = type("Whole", (Honest,), {"answer": lambda self: self.wanted() and self.whole(DATA)})
    with serving(whole, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url], connections=4)
    assert (tmp_path / "file").read_bytes() == DATA
    # Each connection finds out for itself, and lets its answer go; one of them is read to the end.
    assert len(site.requests) <= 8


@pytest.mark.parametrize("connections", [1, 4])
@pytest.mark.parametrize("piece", [0, 1, 12])
def test_a_server_without_ranges_is_left_after_the_second_wrong_piece(piece, connections, tmp_path):
    """Though the right pieces before it come again each time."""
    wrong = bytearray(DATA)
    wrong[piece * ENTRY.piece_size + 7] ^= 1
    whole = type("Whole", (Honest,), {"answer": lambda self: self.wanted() and self.whole(bytes(wrong))})
    with serving(whole, {PATH: DATA}) as site, pytest.raises(IntegrityError, match=f"piece {piece} .* wrong bytes"):
        fetch(ENTRY, tmp_path / "file", [site.url], connections=connections)
    # One connection reads twice to the wrong piece, and once to the end of its first run; others drop some answers.
    assert len(site.requests) <= (3 if connections == 1 else 10)


def test_the_last_of_a_servers_failures_says_which_kind_it_is(tmp_path):
    class Busy(Honest):
        def answer(self):
            _, start, end = self.wanted()
            if len(self.site.requests) < CALM.attempts:
                self.send_error(503)
            else:
                self.give(bytes(len(DATA)), start, end)

    with serving(Busy, {PATH: DATA}) as site, pytest.raises(IntegrityError, match="wrong bytes, 4 times in a row"):
        fetch(ENTRY, tmp_path / "file", [site.url], replace(CALM, least_bytes=1 << 20), connections=1)


def test_a_folder_is_a_mirror_too(tmp_path):
    (tmp_path / "tree" / "blobs").mkdir(parents=True)
    (tmp_path / "tree" / PATH).write_bytes(DATA)
    fetch(ENTRY, tmp_path / "a", [str(tmp_path / "tree")])
    fetch(ENTRY, tmp_path / "b", [f"file://{tmp_path / 'tree'}"])
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == DATA
    (tmp_path / "tree" / PATH).write_bytes(DATA[:-1] + b"!")
    with pytest.raises(IntegrityError):
        fetch(ENTRY, tmp_path / "c", [str(tmp_path / "tree")])
    assert not (tmp_path / "c").exists()


def test_waits_grow_with_jitter_and_are_never_shorter_than_asked():
    waits = [pause_s(3, 0.0, CALM) for _ in range(100)]
    assert 0.002 <= min(waits) < max(waits) <= 0.004
    assert pause_s(50, 0.0, CALM) <= CALM.longest_wait_s
    assert all(7.0 <= pause_s(1, 7.0, CALM) <= 7.7 for _ in range(100))


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        (None, 0),
        ("", 0),
        ("12", 12),
        ("soon", 0),
        ("-3", 0),
        ("²", 0),
        ("9" * 5000, 999_999_999),
        ("Fri, 31 Dec 1999 23:59:59 GMT", 0),
        ("Fri, 31 Dec 99999999999999999999 23:59:59 GMT", 0),
        ("Fri, 99999999999999999999 Dec 2100 23:59:59 GMT", 0),
        ("Fri, 31 Dec 2100 99:99:99 GMT", 0),
    ],
)
def test_retry_after_is_a_number_or_a_date(value, seconds):
    assert retry_after_s(value) == seconds
    assert retry_after_s("Fri, 31 Dec 2100 23:59:59 GMT") > 3600


def test_retry_after_is_honoured(tmp_path):
    asked, waited = [], []

    class Busy(Honest):
        def answer(self):
            with self.site.lock:
                asked.append(self.path)
                first = len(asked) == 1
            if not first:
                super().answer()
                return
            self.send_response(503)
            self.send_header("Retry-After", "100")
            self.send_header("Content-Length", "0")
            self.end_headers()

    patience = replace(CALM, longest_wait_s=200.0, wait=lambda stop, seconds: waited.append(seconds))
    with serving(Busy, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url], patience, connections=1)
    assert (tmp_path / "file").read_bytes() == DATA
    (seconds,) = waited
    assert 100.0 <= seconds <= 110.0


def test_a_redirect_to_another_server_is_followed_and_its_bytes_are_checked(tmp_path):
    with serving(Honest, {PATH: DATA}) as good, misbehaving("wrong_file", {PATH: DATA}, 1, 1.0) as bad:
        for target, comes in ((good, True), (bad, False)):

            class Elsewhere(Honest):
                place = target.url

                def answer(self):
                    self.send_response(302)
                    self.send_header("Location", self.place + self.path)
                    self.send_header("Content-Length", "0")
                    self.end_headers()

            with serving(Elsewhere, {PATH: DATA}) as site:
                if comes:
                    fetch(ENTRY, tmp_path / "file", [site.url])
                    assert (tmp_path / "file").read_bytes() == DATA
                else:
                    with pytest.raises(IntegrityError):
                        fetch(ENTRY, tmp_path / "other", [site.url])


def test_a_full_disk_ends_the_download_and_what_is_there_stays(tmp_path, monkeypatch):
    write, written = os.pwrite, []

    def pwrite(handle, data, offset):
        if os.fstat(handle).st_size == len(DATA):  # the part, and not a draft
            if len(written) == 5:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written.append(offset)
        return write(handle, data, offset)

    monkeypatch.setattr(os, "pwrite", pwrite)
    with serving(Honest, {PATH: DATA}) as site, pytest.raises(OSError, match="No space left"):
        fetch(ENTRY, tmp_path / "file", [site.url])
    monkeypatch.undo()
    assert not (tmp_path / "file").exists()
    assert len(right_pieces(tmp_path / "file.part")) == 5
    begun, _ = beginnings(tmp_path / "file.part", ENTRY, DATA)
    with serving(Honest, {PATH: DATA}) as site:
        fetch(ENTRY, tmp_path / "file", [site.url])
    assert site.sent == len(DATA) - 5 * ENTRY.piece_size - begun
    assert (tmp_path / "file").read_bytes() == DATA


@pytest.mark.parametrize(
    ("kind", "cause"),
    [
        ("trickled_headers", "the headers did not come within 0.15 s"),
        ("trickled_chunks", "only [0-9]+ bytes in 0 s"),
        ("trickle", "only [0-9]+ bytes in 0 s"),
    ],
)
def test_a_server_that_trickles_is_given_up(kind, cause, tmp_path):
    patience = replace(IMPATIENT, attempts=1)
    with misbehaving(kind, {PATH: DATA}, 1, 1.0) as site, pytest.raises(NetworkError, match=cause):
        fetch(ENTRY, tmp_path / "file", [site.url], patience, connections=1)


def test_a_server_that_sends_interim_responses_without_end_is_given_up(tmp_path):
    patience = replace(IMPATIENT, attempts=1, window_s=30.0, idle_s=30.0)
    endless = pytest.raises(NetworkError, match="the headers did not end within 1 MiB")
    with misbehaving("interim", {PATH: DATA}, 1, 1.0) as site, endless:
        fetch(ENTRY, tmp_path / "file", [site.url], patience, connections=1)
