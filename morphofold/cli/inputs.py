"""What commands work on and with: subjects by name, options of measuring as results record them, folders to write."""

import os
import re
from pathlib import Path
from typing import Any

from morphofold.cli.options import Measuring
from morphofold.errors import OptionsClash
from morphofold.io import atomic_folder
from morphofold.spheres.parcellation import check_template


def writable_name(name: str) -> str:
    """Name of a folder for a subject: separators, line breaks and control characters become dashes."""
    return re.sub(r"[/\\\x00-\x1f\x7f-\x9f]", "-", name).strip(". ") or "unnamed"


def subject_folder(subject: str, subjects_dir: str | None) -> Path:
    """Folder of a FreeSurfer subject by its name: in ``subjects_dir``, else in the environment's SUBJECTS_DIR.

    Raises
    ------
    OptionsClash
        If neither is set.
    """
    folder = subjects_dir or os.environ.get("SUBJECTS_DIR")
    if not folder:
        raise OptionsClash(
            f"-s {subject}: the folder of subjects is not given. Set SUBJECTS_DIR, pass --subjects-dir DIR, or pass "
            "the subject's folder as INPUT."
        )
    return Path(folder) / subject


def mark_as_ours(out: Path) -> None:
    """Mark an empty or new folder as ours, so that parts can be written into it before the whole."""
    if not out.is_dir() or not any(out.iterdir()):
        with atomic_folder(out):
            pass


def measuring_options(args: Measuring) -> dict[str, Any]:
    """Options as results record them. Standard accuracy, parcellation and repair, and no cap, are not recorded, so that
    results of older runs stay valid. Raises if the template of --annot-from has no parcellation."""
    annot, template = getattr(args, "annot", None), getattr(args, "annot_from", None)
    if template is not None:
        folder = check_template(template, annot)
        template = str(folder) if Path(template).is_dir() else template
    unusual = {
        "thickness_cap_mm": args.thickness_cap,
        "accuracy": None if args.accuracy == "standard" else args.accuracy,
        "repair": False if args.no_repair else None,
        "annotation": annot,
        "annotation_from": template,
    }
    usual = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    return usual | {key: value for key, value in unusual.items() if value is not None}
