"""Persons with several scans: who was scanned, and in which session, by the name of a subject."""

from __future__ import annotations

import re

LONG = ".long."  # in the name of a longitudinal run of recon-all, TIMEPOINT.long.BASE
#: PERSON_SESSION, as sub-01_ses-2 and anna_tp2, not sub-v01; but in study_v2_007 what follows is the person
SESSION = re.compile(
    r"((?:sub-)?+.+?)[_.-]+(ses-[A-Za-z0-9]+.*|(?:session|ses|timepoint|time|tp|visit|wave|v)[_-]?\d+[A-Za-z]?)",
    re.IGNORECASE,
)


def person_and_session(subject: str) -> tuple[str, str]:
    """The person that a subject is a scan of, by its name, and the session; the subject itself and "" without sessions.

    ``sub-01_ses-2`` is sub-01, ses-2. A longitudinal run of FreeSurfer is of the person of its time point if the base
    bears that name, else of its base: ``anna_ses1.long.anna_base`` is anna, ses1; ``x.long.ben`` is ben, x.
    """
    visit, long, base = subject.partition(LONG)
    named = SESSION.fullmatch(visit)
    if long and base and not (named and named[1] in base):
        return person_and_session(base)[0], visit.removeprefix(base).lstrip("_.-") or visit
    return (named[1], named[2]) if named else (subject, "")
