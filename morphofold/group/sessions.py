"""Persons with several scans: who was scanned, and in which session, by the name of a subject."""

import re

LONG = ".long."  # in the name of a longitudinal run of recon-all, TIMEPOINT.long.BASE
#: PERSON_SESSION, as sub-01_ses-2, anna_tp2 and anna_v2; but HC_v02 is volunteer 2, and study_v2_007 a person
SESSION = re.compile(
    r"((?:sub-)?+.+?)[_.-]+(ses-[A-Za-z0-9]+.*|(?:session|ses|timepoint|time|tp|visit|wave)[_-]?\d+[A-Za-z]?|v[1-9])",
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
