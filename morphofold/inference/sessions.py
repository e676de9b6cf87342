"""Persons with several scans: who was scanned, and in which session, by the name of a subject."""

from __future__ import annotations

import re

LONG = ".long."  # in the name of a longitudinal run of recon-all, TIMEPOINT.long.BASE
#: PERSON_SESSION, as sub-01_ses-2 and anna_tp2
SESSION = re.compile(
    r"(.+?)[_.-]+(ses-[A-Za-z0-9]+.*|(?:session|ses|timepoint|time|tp|visit|wave|v)[_-]?\d.*)", re.IGNORECASE
)


def person_and_session(subject: str) -> tuple[str, str]:
    """The person that a subject is a scan of, by its name, and the session; the subject itself and "" without sessions.

    ``anna_ses1.long.anna``, a longitudinal run of FreeSurfer, is of its base: anna, ses1. ``sub-01_ses-2`` is sub-01,
    ses-2.
    """
    visit, long, base = subject.partition(LONG)
    if long and base:
        return person_and_session(base)[0], visit.removeprefix(base).lstrip("_.-") or visit
    named = SESSION.fullmatch(subject)
    return (named[1], named[2]) if named else (subject, "")
