"""Measure on this machine: ``bench speed`` times the force kernel of the solver."""

from __future__ import annotations

import argparse
import json


def add_args(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=["speed"], help="speed: brick-steps per second")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="time per case (default: 2)")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    import numba

    from morphofold.sim.speed import element_speed

    if not 0 < args.seconds < 3600:
        raise ValueError(f"--seconds must be a positive number below 3600, got {args.seconds}.")
    cores = numba.get_num_threads()
    rows = [
        element_speed(cells, threads=threads, seconds=args.seconds)
        for cells in (16, 32, 48)
        for threads in dict.fromkeys((1, cores))
    ]
    if args.json:
        print(json.dumps(rows, indent=1))
        return 0
    print("million 8-point brick-steps per second")
    print(f"{'bricks':>8} {'threads':>8} {'median':>8} {'best':>8} {'per core':>9}")
    for r in rows:
        print(
            f"{r['bricks']:8,} {r['threads']:8} {r['median']:8.1f} {r['best']:8.1f} {r['median'] / r['threads']:9.1f}"
        )
    return 0
