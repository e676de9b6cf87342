"""What commands work on and with: subjects by name, options of measuring as results record them, folders to write."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import Any
from unicodedata import category

from morphofold.cli.options import Measuring
from morphofold.errors import NotReadable, OptionsClash
from morphofold.io import atomic_folder
from morphofold.spheres.parcellation import check_template


def writable_name(name: str) -> str:
    """Name of a folder for a subject: separators, line breaks and control characters become dashes."""
    return "".join("-" if c in "/\\" or category(c) == "Cc" else c for c in name).strip(". ") or "unnamed"


def subject_folder(subject: str, subjects_dir: str | None) -> Path:
    """Folder of a FreeSurfer subject by its name: in ``subjects_dir``, else in the environment's SUBJECTS_DIR.

    Raises
    ------
    OptionsClash
        If neither is set.
    NotReadable
        If ``subject`` is a path.
    FileNotFoundError
        If the folder or the subject does not exist; the message lists subjects that exist.
    """
    subject = subject.rstrip("/")  # which a shell's completion adds
    folder_of_subjects = subjects_dir or os.environ.get("SUBJECTS_DIR")
    if not folder_of_subjects:
        raise OptionsClash(
            f"-s {subject}: the folder of subjects is not given. Set SUBJECTS_DIR, pass --subjects-dir DIR, or pass "
            "the subject's folder as INPUT."
        )
    folder, set_by = Path(folder_of_subjects), "--subjects-dir" if subjects_dir else "SUBJECTS_DIR"
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder, given by {set_by}. Name the folder that holds subjects.")
    if subject in ("", ".", "..") or Path(subject).name != subject:
        raise NotReadable(f"-s {subject!r}: is not a folder's name in {folder}. Pass a path as INPUT, without -s.")
    if not (folder / subject).is_dir():
        names = sorted(p.name for p in folder.iterdir() if (p / "surf").is_dir())
        near = difflib.get_close_matches(subject, names, n=8, cutoff=0.5)
        names = near + [name for name in names if name not in near]
        there = f"{', '.join(names[:8])}{f' and {len(names) - 8} more' if len(names) > 8 else ''}"
        raise FileNotFoundError(f"{folder / subject}: no such subject. {set_by} holds {there if names else 'none'}.")
    return folder / subject


def mark_as_ours(out: Path) -> None:
    """Mark an empty or new folder as ours, so that parts can be written into it before the whole."""
    if not out.is_dir() or not any(out.iterdir()):
        with atomic_folder(out):
            pass


def measuring_options(args: Measuring) -> dict[str, Any]:
    """Options as results record them. Standard accuracy, parcellation and repair, and no cap, are not recorded, so that
    results of older runs stay valid. Raises if the template of --annot-from has no parcellation."""
    options: dict[str, Any] = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    annot, template = getattr(args, "annot", None), getattr(args, "annot_from", None)
    unusual = {
        "thickness_cap_mm": args.thickness_cap,
        "accuracy": None if args.accuracy == "standard" else args.accuracy,
        "repair": False if args.no_repair else None,
        "annotation": annot,
    }
    options |= {key: value for key, value in unusual.items() if value is not None}
    if template is not None:
        folder = check_template(template, annot)
        options["annotation_from"] = str(folder) if Path(template).is_dir() else template
    return options
