"""Measure on this machine: ``bench speed`` times the solver, ``bench effects`` what each effect adds to a step."""

from __future__ import annotations

import argparse
import json
from typing import Any


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what", choices=["speed", "effects"], help="speed: brick-steps per second; effects: their cost per step"
    )
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="time per case (default: 2)")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    if not 0 < args.seconds < 3600:
        raise ValueError(f"--seconds must be a positive number below 3600, got {args.seconds}.")
    rows, lines = _speed(args.seconds) if args.what == "speed" else _effects(args.seconds)
    print(json.dumps(rows, indent=1) if args.json else "\n".join(lines))
    return 0


def _speed(seconds: float) -> tuple[list[dict[str, Any]], list[str]]:
    import numba

    from morphofold.sim.speed import element_speed

    cores = numba.get_num_threads()
    rows = [
        element_speed(cells, threads=threads, seconds=seconds)
        for cells in (16, 32, 56)
        for threads in dict.fromkeys((1, cores))
    ]
    lines = [
        "million 8-point brick-steps per second: force kernel (median, best) and whole steps",
        f"{'bricks':>8} {'threads':>8} {'median':>8} {'best':>8} {'steps':>8} {'steps per core':>15}",
        *(
            f"{r['bricks']:8,} {r['threads']:8} {r['median']:8.1f} {r['best']:8.1f} {r['steps']:8.1f} "
            f"{r['steps'] / r['threads']:15.1f}"
            for r in rows
        ),
    ]
    return rows, lines


def _effects(seconds: float) -> tuple[list[dict[str, Any]], list[str]]:
    from morphofold.sim.speed import effect_costs

    rows = effect_costs(seconds=seconds)
    lines = [
        "what each effect adds to a step of a draft octant, one thread",
        f"{'effect':28} {'ms':>8} {'share':>8}",
        *(f"{r['effect']:28} {r['ms']:8.3f} {r['share']:8.1%}" for r in rows),
    ]
    return rows, lines
