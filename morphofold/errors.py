"""Kinds of refusals: each has a fixed code, and says its cause and its cure (docs/messages.md is made from these).

All are ``ValueError``. The error line of a command ends with the code in brackets, ``[open-surface]``; in Python it is
``error.code``, or the class to catch. Files that are missing, exist already or can't be read raise Python's own
``FileNotFoundError``, ``FileExistsError`` and the like; values of a wrong type raise ``TypeError``. Commands print the
codes of ``PYTHON_CODES`` for these.
"""

import errno
import re

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # only from writes; Python doesn't name the file
#: codes of Python's own errors that commands print, subclasses first (docs/messages.md)
PYTHON_CODES: dict[type[Exception], str] = {
    FileNotFoundError: "no-such-file",
    FileExistsError: "exists-already",
    IsADirectoryError: "is-a-folder",
    NotADirectoryError: "not-a-folder",
    PermissionError: "no-permission",
    OSError: "input-output",
    MemoryError: "no-memory",
    TypeError: "wrong-type",
}


class Refusal(ValueError):
    """The work can't be done with this input."""

    code = "refusal"

    def __init_subclass__(cls) -> None:
        cls.code = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", cls.__name__).lower()


def code_of(error: BaseException) -> str:
    """Code of an error; that of ``Refusal`` for one that has none of its own."""
    if isinstance(error, Refusal):
        return error.code
    if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
        return "disk-full"
    return next((code for error_class, code in PYTHON_CODES.items() if isinstance(error, error_class)), Refusal.code)


# --- numbers and arrays


class OutOfRange(Refusal):
    """A number is outside the range in which it has a meaning, or in which the method was tested.

    Give a number within the limits in the message.
    """


class WrongShape(Refusal):
    """The shape of an array, or the length of a list, does not fit the rest of the input.

    Pass one value per vertex (or what the message names), in the order of the vertices of its surface.
    """


class NotFinite(Refusal):
    """Values are NaN or infinite, but must be finite numbers.

    Correct the file or the array at the place in the message, or leave it out.
    """


class TooLarge(Refusal):
    """The work would take more memory or disk space than is sensible or allowed.

    Use a coarser mesh or voxel, a smaller portion, fewer workers, or what the message proposes.
    """


# --- words, options and scenes


class UnknownName(Refusal):
    """A name is unknown: a mode, level, key, region, scene, figure or subject.

    Use one of the names in the message; check the spelling.
    """


class NamedTwice(Refusal):
    """A name, value or seed is given twice, but each may be given only once.

    Give it once, or use another name for the second one.
    """


class BadUsage(Refusal):
    """A command or option is unknown, an argument is missing, or a value is not one of the choices.

    See --help of the command.
    """


class NotReadable(Refusal):
    """A text does not have the required form, such as `NAME=DIR`, a range, a duration or TOML.

    Write it like the example in the message.
    """


class OptionsClash(Refusal):
    """Options or arguments contradict each other, or one is given without another that it needs.

    Leave out, or add, the option in the message.
    """


class DoesNotApply(Refusal):
    """An option, effect or key has no meaning for this kind of scene, body, surface or run.

    Leave it out, or use it with a kind that supports it.
    """


class NotStudied(Refusal):
    """An error or a time is asked for in a range where none was measured.

    Stay within the studied range, or estimate the error of a finished run (--estimate).
    """


class NothingToDo(Refusal):
    """There is nothing to do: no surface, subject, value to vary or curve to draw is given.

    Give at least one.
    """


class ImpossibleBody(Refusal):
    """Lengths of a scene contradict each other, such as a cortex that leaves no core or a skull that is too small.

    Change the length in the message.
    """


class NoSolution(Refusal):
    """There is no solution in the range that is searched, or the body is unstable before growth begins.

    Widen the range, or change the scene as described in the message.
    """


# --- files and folders


class DamagedFile(Refusal):
    """A file is truncated, damaged or inconsistent.

    Copy it again from its source, or write it again.
    """


class WrongFile(Refusal):
    """A file does not contain what was asked for, or has a format that morphofold can't read or write.

    Give the file that the message asks for, or convert it.
    """


class NotFetched(Refusal):
    """A file is only a pointer to its content, which DataLad, git-annex or git-lfs has not fetched.

    Fetch it, with the command in the message.
    """


class Mismatch(Refusal):
    """Files or folders do not belong together: they are from two subjects, runs or versions, or have changed since.

    Take both from one source, restore the old file, or begin in another folder.
    """


class MissingPart(Refusal):
    """A file can be read, but a part that is needed is missing: regions, a gyral graph, stages, a map.

    Analyze or grow again with this part, or leave out what needs it.
    """


# --- surfaces and meshes


class OpenSurface(Refusal):
    """A surface has a border, but the measure needs a closed surface.

    Close its holes, or leave out the measure.
    """


class SeveralPieces(Refusal):
    """A surface is in several pieces, but only one piece can be unfolded.

    Give each piece a file of its own; small pieces beside a large one are left out by themselves.
    """


class Handles(Refusal):
    """A closed surface has handles, like a torus, so it does not unfold to a sphere.

    Cut the handles first, as FreeSurfer's mris_fix_topology does.
    """


class BadMesh(Refusal):
    """Triangles or tetrahedra form no valid surface or body: they branch, are torn, flipped or flat, or overlap.

    Let morphofold repair it (the default of analyze), or repair the mesh at the place in the message.
    """


class UnlikeSurfaces(Refusal):
    """White and pial are no pair: the same surface twice, of two people, crossed over, or with different triangles.

    Give white and pial of one hemisphere from one reconstruction.
    """


class InsideOut(Refusal):
    """The faces of a surface are clockwise seen from outside.

    Reverse the order of the vertices in each face.
    """


class NoCortex(Refusal):
    """No vertices, or too few, are cortex, so there is nothing to measure.

    Give the right cortex label, or leave it out.
    """
