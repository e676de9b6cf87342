"""Options of measuring a surface, as results record them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from morphofold.cli.options import Measuring
from morphofold.spheres.parcellation import check_template


def measuring_options(args: Measuring) -> dict[str, Any]:
    """Options as results record them. Standard accuracy, parcellation and repair, and no cap, are not recorded, so that
    results of older runs stay valid. Raises if the template of --annot-from has no parcellation."""
    options: dict[str, Any] = {"curvature_scale_mm": args.curvature_scale, "gyral_width_mm": args.gyral_width}
    options |= {} if args.thickness_cap is None else {"thickness_cap_mm": args.thickness_cap}
    options |= {} if args.accuracy == "standard" else {"accuracy": args.accuracy}
    options |= {"repair": False} if args.no_repair else {}
    annot, template = getattr(args, "annot", None), getattr(args, "annot_from", None)
    options |= {} if annot is None else {"annotation": annot}
    if template is not None:
        folder = check_template(template, annot)
        options["annotation_from"] = str(folder) if Path(template).is_dir() else template
    return options
