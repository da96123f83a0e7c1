"""Operations on submissions by the team that owns them: send, look at, publish, withdraw."""

from __future__ import annotations

import re
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, func, insert, select

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.text import composed, spellings
from oysterbench.hub.addresses import network
from oysterbench.hub.canonical import parse
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.publishing.publish import ranked_instead
from oysterbench_leaderboard.publishing.truths import other_truth
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange, copied_curves, usable
from oysterbench_leaderboard.submissions.accounts.rates import DAY_S, DailyReads, Sampler, hours_and_minutes
from oysterbench_leaderboard.submissions.catalogue import Catalogue, Wanted
from oysterbench_leaderboard.submissions.database import (
    Submission,
    SubmissionDatabase,
    change,
    find,
    lock_team,
    log_event,
    submissions,
    unpublish,
    utc,
)
from oysterbench_leaderboard.submissions.estimates import Estimates, Upload, remove_left
from oysterbench_leaderboard.submissions.private_log import private_log
from oysterbench_leaderboard.submissions.reading.refusals import SERVER_FAULTS, Refusal
from oysterbench_leaderboard.submissions.sandbox import namespaces, sandbox
from oysterbench_leaderboard.submissions.settings import FILE, SubmissionSettings
from oysterbench_leaderboard.submissions.words import Form, check_words

AGAIN_S = 3600.0
ID = re.compile("[0-9a-f]{16}")
LATER = "a later submission of the same method by the same team"


class Service:
    """Everything that a submission server does, except for HTTP.

    store: record store of the board, where published records go; changed: called after each change of the board
    """

    def __init__(
        self,
        settings: SubmissionSettings,
        catalogue: Catalogue,
        store: RecordStore,
        changed: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.settings, self.catalogue, self.store, self.changed, self.clock = settings, catalogue, store, changed, clock
        self.database = SubmissionDatabase(settings)
        self.incoming, self.estimates = settings.folder / "incoming", Estimates(settings.place)
        self.incoming.mkdir(exist_ok=True)
        self.scored = RecordStore(settings.folder / "scored")
        truths = {str(path.parent.resolve()) for one in catalogue.splits.values() for path in one.truth.values()}
        private = filter(None, (settings.folder, self.estimates.folder))
        self.hidden = (*(str(folder.resolve()) for folder in private), *sorted(truths))
        self.wake = threading.Event()
        self.reads = DailyReads(settings.reads_per_day, self.clock)
        self._refusals = Sampler(settings.refusals_of_one, settings.refusals_of_strangers)
        self._checks = threading.Semaphore(settings.checks_at_once)
        self.forks = sandbox.fork_server()
        self.log = private_log(settings.folder / "private.log")
        self._settle()

    def now(self) -> str:
        """Current UTC time in ISO 8601."""
        return utc(self.clock())

    def close(self) -> None:
        """Release all resources: fork server, database and log."""
        self.forks.close()
        self.database.close()
        for handler in list(self.log.handlers):
            handler.close()
            self.log.removeHandler(handler)

    # Sending:

    def submit(self, team: str, form: Form, upload: Upload) -> tuple[Submission, bool]:
        """Check and queue an upload of a team; return the submission and whether it is new: the same bytes for the same
        method, split and track are one submission.

        Raises Refusal with the reason, naming file and line; then no submission is counted.
        """
        form, wanted = self.check_form(form)
        known = self.announced(team, form, upload.digest)
        if known is not None:
            return known, False
        with self._checks:
            facts = sandbox.check(self.settings, upload.path, wanted, self.hidden, self.log.info, self.forks)
        if facts["kind"] != "results" and not self.catalogue.splits[form.split].truth:
            raise Refusal(
                "split",
                f"{form.split} has no ground truth on this server, which accepts only results for it: send the "
                "results.json",
            )
        self.estimates.keep(upload)
        return self._accept(team, form, upload, facts)

    def announced(self, team: str, form: Form, digest: str) -> Submission | None:
        """Return the existing submission of bytes with this SHA-256; None where they are to be uploaded.

        form: as `check_form` returns it. Raises Refusal where the team's quota is used up, so that nobody learns of it
        only after an upload of an hour.
        """
        with self.database.reading() as connection:
            known = self._same(connection, team, form, digest)
            if known is None:
                self._check_quota(connection, team, form.split)
        return None if known is None or self._ours(known) else known

    def check_form(self, form: Form) -> tuple[Form, Wanted]:
        """Return the form with its track filled in, and what its predictions must cover. Raises Refusal naming the
        field."""
        form.check()
        _, wanted = self.catalogue.find(form.split, form.track)
        stripped = {key: getattr(form, key).strip() for key in ("url", "summary")}
        return replace(form, track=wanted.track, method=composed(form.method.strip()), **stripped), wanted

    def _same(self, connection: Connection, team: str, form: Form, digest: str) -> Submission | None:
        c = submissions.c
        same = (c.team == team, c.track == form.track, c.split == form.split, c.method == form.method)
        return next(iter(find(connection, *same, c.digest == digest)), None)

    def _check_quota(self, connection: Connection, team: str, split: str) -> None:
        c, since = submissions.c, self.clock() - DAY_S
        of_team = select(func.count(), func.min(c.created_s)).where(c.team == team)
        today, oldest = connection.execute(of_team.where(c.created_s > since)).one()
        if today >= self.settings.per_day:
            wait_s = int(oldest - since) + 1
            raise Refusal(
                "quota",
                f"{today} submissions in 24 hours are the limit for a team; the next is accepted in "
                f"{hours_and_minutes(wait_s)}",
                wait_s,
            )
        of_split, _ = connection.execute(of_team.where(c.split == split)).one()
        if of_split >= self.settings.per_split:
            raise Refusal("quota", f"{of_split} submissions to {split} are the limit for a team")

    def _accept(self, team: str, form: Form, upload: Upload, facts: dict[str, Any]) -> tuple[Submission, bool]:
        at_s = self.clock()
        at = utc(at_s)
        with self.database.writing() as connection:
            lock_team(connection, team)
            known = self._same(connection, team, form, upload.digest)
            if known is not None:
                return self._again(connection, known, at)
            self._check_quota(connection, team, form.split)
            made = Submission(
                id=secrets.token_hex(8),
                team=team,
                **asdict(form),
                kind=facts["kind"],
                digest=upload.digest,
                size=upload.size,
                created=at,
                created_s=at_s,
                updated=at,
            )
            connection.execute(insert(submissions).values(asdict(made)))
            log_event(connection, at, team, "queued", made.id, f"{form.method} on {form.split} ({form.track})")
        self.wake.set()
        return made, True

    def _ours(self, known: Submission) -> bool:
        """Whether a submission failed through the server's fault and may be sent again: at most once an hour, because
        an upload may have been crafted to crash its reader."""
        long_ago = known.updated < utc(self.clock() - AGAIN_S)
        return known.state == "failed" and known.reason in SERVER_FAULTS and long_ago

    def _again(self, connection: Connection, known: Submission, at: str) -> tuple[Submission, bool]:
        """Queue a submission again that failed through the server's fault; return it, and whether it was queued."""
        state = submissions.c.state == "failed"
        if not self._ours(known) or not change(connection, known.id, at, state, state="queued", reason="", attempt=0):
            return known, False
        log_event(connection, at, known.team, "queued", known.id, "sent again")
        self.wake.set()
        return replace(known, state="queued", reason="", attempt=0, updated=at), True

    def self_test(self) -> None:
        """Check that uploads can be read, by reading a small one. Raises ResultError where this server cannot, or where
        the namespaces that its settings require are not available."""
        if self.settings.needs_namespaces and (why := namespaces.missing()):
            raise ResultError(f"needs_namespaces of {FILE} requires a sandbox that is not available here: {why}")
        self.log.info("sandbox: %s", sandbox.in_force())
        wanted = Wanted("slam", "self-test", "", False, ("one",))
        with tempfile.NamedTemporaryFile(dir=self.incoming, suffix=".tum") as file:
            file.write(b"0.0 0 0 0 0 0 0 1\n1.0 1 0 0 0 0 0 1\n")
            file.flush()
            try:
                sandbox.check(self.settings, Path(file.name), wanted, self.hidden, self.log.info, self.forks)
            except Refusal as refusal:
                raise ResultError(
                    f"{self.settings.folder}: uploads cannot be read here, a valid one was refused: {refusal.reason}; "
                    "private.log there says why"
                ) from None

    def refused(self, who: str, what: str, refusal: Refusal, stranger: bool) -> None:
        """Log a refusal with its reason; of many within a minute only some, with the number of those left out.

        who: a team, or the address of a stranger; what: method and path of the request
        """
        before = self._refusals.ask(network(who) if stranger else f"team {who}", stranger)
        if before is None:
            return
        more = f" ({before} more before it were not written down)" if before else ""
        with self.database.writing() as connection:
            log_event(connection, self.now(), who, "refused", why=f"{what}: {refusal.kind}: {refusal.reason}{more}")

    # Looking:

    def of_team(self, team: str, limit: int = 200) -> list[Submission]:
        """Return a team's submissions, newest first."""
        with self.database.reading() as connection:
            return find(connection, submissions.c.team == team, limit=limit)

    def get(self, team: str, id: str) -> Submission:
        """Return a submission of a team. Raises the same Refusal for those of other teams as for those that do not
        exist."""
        with self.database.reading() as connection:
            return self._own(connection, team, id)

    def _own(self, connection: Connection, team: str, id: str, lock: bool = False) -> Submission:
        asked = submissions.c.id == id, submissions.c.team == team
        found = find(connection, *asked, lock=lock) if ID.fullmatch(id) else []
        if not found:
            raise Refusal("absent", "you have no such submission")
        return found[0]

    def record(self, submission: Submission) -> Record | None:
        """Scored record of a submission, for its team only, or the published one where its file is damaged; None where
        it has none. Raises ResultError where both are damaged."""
        if not submission.record:
            return None
        found = usable((self.scored, self.store), submission.record, submission.published)
        return found or self.scored.record(submission.record)

    def queued_before(self, submission: Submission) -> int:
        """Number of queued submissions that are older than this one."""
        older = submissions.c.state == "queued", submissions.c.created_s < submission.created_s
        with self.database.reading() as connection:
            return connection.execute(select(func.count()).select_from(submissions).where(*older)).scalar_one()

    # Publishing:

    def publish(self, team: str, id: str) -> Submission:
        """Put a submission on the board, where it supersedes the team's current record of the same method; idempotent.
        Raises Refusal where its state is not "done", or the same files are there under another name."""
        with self.store.publishing():  # or two teams would pass the checks side by side
            with self.database.writing() as connection:
                lock_team(connection, team)
                found = self._own(connection, team, id, lock=True)
                if found.state != "done":
                    raise Refusal("state", f"only finished submissions can be published; this one is {found.state}")
                if found.published in self.store.digests():
                    return found
                if new := not found.published:
                    record = self._in_place(connection, found)
                    # On disk before the database refers to it, so that publication can be completed after a crash.
                    self.scored.add(record)
                    change(connection, id, at := self.now(), published=record.digest)
                    log_event(connection, at, team, "published", id, record.digest)
                    found = replace(found, published=record.digest, updated=at)
                elif odd := other_truth(self.store, [self.scored.record(found.published)]):  # as others may be there
                    raise Refusal("state", odd)
            try:
                self._show(self.scored.record(found.published))
            except OSError:
                if found.published not in self.store.digests():  # a network disk may have done it, and fail after that
                    if new:  # as if it had not been tried: when it is again, others may be there
                        unpublish(self.database, found, self.now())
                    raise
        self.changed()
        return found

    def _in_place(self, connection: Connection, found: Submission) -> Record:
        """Scored record of a submission, in place of the team's current record of the same method, if there is one.
        Raises Refusal where it is a reported one in place of a ranked one, or of another ground truth than the board's,
        or the team has published the same files under another name."""
        c, record = submissions.c, self.scored.record(found.record)
        if ranked := ranked_instead(self.store, record):
            theirs = f"your {self.store.record(ranked).tier} record {ranked[:8]} of {record.method}"
            do = "withdraw that first, or send these under another method name"
            raise Refusal("state", f"reported results do not replace {theirs}: {do}")
        if odd := other_truth(self.store, [record]):
            raise Refusal("state", odd)
        same = (c.team == found.team, c.track == found.track, c.split == found.split)
        shown_now, of_method = (c.published != "", c.state == "done"), c.method.in_(spellings(found.method))
        if others := find(connection, *same, *shown_now, c.digest == found.digest, ~of_method, limit=1):
            there = f"these files are on the board already, as your method {others[0].method}"
            do = f"one result has one name; to change it, withdraw submission {others[0].id} first"
            raise Refusal("state", f"{there}: {do}")
        before = find(connection, *same, *shown_now, of_method)
        kept = (usable((self.scored, self.store), other.published) for other in before)
        shown = [*filter(None, kept), *self._rescored(before)]
        replaced = {each.supersedes for each in shown}
        current = [each for each in shown if each.board == record.board and each.digest not in replaced]
        return replace(record, supersedes=current[0].digest, reason=LATER) if current else record

    def withdraw(self, team: str, id: str, reason: str = "") -> Submission:
        """Withdraw a submission, whatever its state; idempotent. A published record stays in the store, marked as
        withdrawn, and so do those that it was scored again into."""
        check_words("reason", reason)
        with self.database.writing() as connection:
            found = self._own(connection, team, id, lock=True)
            if found.state != "withdrawn":
                at, reason = self.now(), reason.strip() or "withdrawn by the team"
                notice = at if found.published else ""
                change(connection, id, at, state="withdrawn", reason=reason, notice=notice)
                log_event(connection, at, team, "withdrawn", id, reason)
                found = replace(found, state="withdrawn", reason=reason, notice=notice, updated=at)
        if found.notice:  # also of an earlier withdrawal: writing to the board may have failed
            self._announce([found])
            self.changed()
        return found

    def _rescored(self, several: Sequence[Submission]) -> list[Record]:
        """Records on the board that were scored again from the uploads of published submissions of one method."""
        if not several:
            return []
        published = {one.published for one in several}
        uploads = {(one.track, one.split, one.digest) for one in several}
        return [
            record
            for digest, record in self.store.records_by(several[0].team, several[0].method)
            if digest not in published
            and any((record.track, record.split, upload) in uploads for upload in record.estimates.values())
        ]

    def _show(self, record: Record) -> None:
        """Put a record and its curves on the board; idempotent."""
        if record.curves and (why := copied_curves(self.scored, self.store, record.curves)):
            self.log.error("record %s is on the board without its drawing: %s", record.digest, why)
        self.store.add(record)

    def _announce(self, gone: Sequence[Submission]) -> None:
        """Mark the records of withdrawn submissions, unless the operators have restored the published one since;
        idempotent. Those that are withdrawn already keep the reason: it may be that of the operators."""
        latest = {change.record: change for change in self.store.read_status_changes()[0]}
        for one in gone:
            if (last := latest.get(one.published)) and last.action == "restored" and last.created > one.notice:
                continue
            there = [one.published, *(record.digest for record in self._rescored([one]))]
            for digest in (each for each in there if each not in latest or latest[each].action != "withdrawn"):
                self.store.add_status_change(StatusChange(digest, "withdrawn", one.reason, self.now()))

    def _settle(self) -> None:
        """Complete what a crash left undone: bring the board in line with what the database calls published or
        withdrawn, and delete files that were being received when the server ended."""
        with self.database.reading() as connection:
            shown = find(connection, submissions.c.published != "")
        for submission in shown:
            try:
                self._show(self.scored.record(submission.published))
            except OysterbenchError as error:  # a damaged file: all others are served nevertheless
                self.log.error("submission %s was not put on the board again: %s", submission.id, error)
        # Also those that have their marks: they may have been scored again since.
        self._announce([submission for submission in shown if submission.notice])
        remove_left(self.incoming, self.settings.upload_s)

    # Scoring, for the dispatcher:

    def build(self, submission: Submission, answer: dict[str, Any]) -> Record:
        """Build the record of an answer from the sandbox, parsed as the board would read it. Raises ResultError."""
        results = tuple(ResultRecord.from_dict(values) for values in answer["results"])
        reported = submission.kind == "results"
        predicted = [] if reported else [result.sequence for result in results if result.failure is None]
        record = Record(
            method=submission.method,
            team=submission.team,
            tier="reported" if reported else "scored",
            results=results,
            url=submission.url,
            summary=submission.summary,
            data_set=answer["data_set"],
            curves=self.scored.add_curves(answer["curves"]) if answer["curves"] else "",
            estimates={f"{sequence}/1": submission.digest for sequence in predicted},
            created=submission.created,
        )
        try:
            return Record.from_dict(parse(record.data, "record"))
        except (OysterbenchError, UnicodeEncodeError, ValueError) as error:
            raise ResultError(f"the record cannot be read again: {error}") from None
