"""What is refused, by kind: each has a code that stays, its cause and its cure (docs/messages.md is made from these).

All are ``ValueError``. Commands end their one line with the code in brackets, ``[open-surface]``; in Python it is
``error.code``, or the class to catch. What was missing, taken or not to be read on disk has Python's own
``FileNotFoundError``, ``FileExistsError`` and the like; what is of a wrong type ``TypeError``.
"""

from __future__ import annotations

import re


class Refusal(ValueError):
    """Input with which the work can't be done."""

    code = "refusal"
    cure = ""

    def __init_subclass__(cls) -> None:
        cls.code = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", cls.__name__).lower()


# --- numbers and arrays


class OutOfRange(Refusal):
    """A number lies outside the limits within which it has a meaning, or within which the method was tested."""

    cure = "Take a number within the limits that the message names."


class WrongShape(Refusal):
    """An array has another shape, or a list another length, than the rest of the input asks for."""

    cure = "Pass one value per vertex (or what the message names), in the order of the surface it belongs to."


class NotFinite(Refusal):
    """Values are NaN or infinite where each must be a number."""

    cure = "Mend the file or the array at the place that the message names, or leave it out."


class TooLarge(Refusal):
    """The work would take more memory or disk than is sensible, or than was allowed."""

    cure = "Take a coarser mesh or voxel, a smaller portion, fewer workers, or what the message proposes."


# --- words, options and scenes


class UnknownName(Refusal):
    """A name is none of those that there are: a mode, level, key, region, scene, figure or subject."""

    cure = "Take one of the names in the message; mind the spelling."


class NamedTwice(Refusal):
    """A name, value or seed is given twice where each must be there once."""

    cure = "Give it once, or give the other one another name."


class NotReadable(Refusal):
    """A text can't be read as what it stands for, such as `NAME=DIR`, a range, a length of time or TOML."""

    cure = "Write it as the example in the message."


class OptionsClash(Refusal):
    """Options or arguments are given together that contradict each other, or one goes without its other half."""

    cure = "Leave out, or add, the one that the message names."


class DoesNotApply(Refusal):
    """An option, effect or key has no meaning for this kind of scene, body, surface or run."""

    cure = "Leave it out, or apply it to a kind that has it."


class NotStudied(Refusal):
    """An error or a time is asked for where none was measured, so that any number would be made up."""

    cure = "Stay within what was studied, or find the error from a coarser run (--estimate)."


class NothingToDo(Refusal):
    """The list of what to do is empty: no surface, subject, value to vary or curve to draw."""

    cure = "Name one at least."


class ImpossibleBody(Refusal):
    """Lengths of a scene contradict each other, such as a cortex that leaves no core or a skull without room."""

    cure = "Change the length that the message names."


class NoSolution(Refusal):
    """What is sought does not exist in the range that is searched, or the body is unstable before growth begins."""

    cure = "Widen the range, or change the scene as the message says."


# --- files and folders


class DamagedFile(Refusal):
    """A file is cut, damaged or contradicts itself."""

    cure = "Copy it again from its source, or write it anew."


class WrongFile(Refusal):
    """A file holds something else than was asked for, or is of a format that is not read or written."""

    cure = "Name the file that the message asks for, or convert it."


class Mismatch(Refusal):
    """Files or folders do not belong together: of two subjects, two runs, two versions, or changed since."""

    cure = "Take both from one source, put the old file back, or begin in another folder."


class MissingPart(Refusal):
    """What is needed is not there, though the file can be read: regions, a gyral graph, stages, a map."""

    cure = "Analyze or grow anew with it, or leave out what needs it."


# --- surfaces and meshes


class OpenSurface(Refusal):
    """A surface has a border, and the measure needs an inside."""

    cure = "Close its holes, or leave the measure out."


class BadMesh(Refusal):
    """Triangles or tetrahedra form no surface or body: branching, torn, flipped, flat or lying over one another."""

    cure = "Let morphofold repair it (the default of analyze), or repair the mesh at the place in the message."


class UnlikeSurfaces(Refusal):
    """White and pial are no pair: the same surface twice, of two people, crossed over, or with different triangles."""

    cure = "Name white and pial of one hemisphere from one reconstruction."


class InsideOut(Refusal):
    """The faces of a surface run clockwise seen from outside."""

    cure = "Reverse the order of the vertices in each face."


class NoCortex(Refusal):
    """No vertex, or too few, is cortex, so that there is nothing to measure."""

    cure = "Name the right cortex label, or leave it out."
