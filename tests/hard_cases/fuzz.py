"""Damages small files of every format and reads them: ``python tests/hard_cases/fuzz.py --seconds 60 --seed 1``.

No damage may end in anything but a surface (map, scene, ...) or one clear line. What does is printed, one line of JSON
each, and its bytes are kept in --keep. Ends with 1 if there was any.
"""

import argparse
import faulthandler
import json
import os
import re
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from hard_cases.made_files import MEMORY, resource, samples, verdict

SLOWEST = 10  # seconds that a small file may take
ATTRIBUTE = re.compile(rb'(\w+)="([^"]*)"')
NUMBERS = [
    b"-1",
    b"0",
    b"99999999999",
    b"1e999",
    b"nan",
    b"1" * 5000,
    b"2147483648",
    b"-0",
    b"0x10",
    b"true",
    b"null",
    b"[]",
    b"{}",
    b'""',
    b"1" + b"0" * 400,
]
WORDS = [0, 1, 0x7F, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x100000, 0x7FFFFFFFFFFFFFFF]


def damaged(raw, rng, other):
    """Bytes with one to three damages."""
    raw = bytearray(raw)
    for _ in range(rng.integers(1, 4)):
        _damage(raw, rng, other)
    return bytes(raw)


def _damage(raw, rng, other):
    if not raw:
        return
    head = rng.random() < 0.5  # half of them where headers are
    at = int(rng.integers(min(len(raw), 400) if head else len(raw)))
    kind = rng.integers(10)
    if kind == 0:
        raw[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del raw[at:]
    elif kind == 2:
        del raw[at : at + int(rng.integers(1, 64))]
    elif kind == 3:
        raw[at:at] = raw[at : at + int(rng.integers(1, 64))] * int(rng.integers(1, 5))
    elif kind == 4:
        width = int(rng.choice([1, 2, 4, 8]))
        value = int(rng.choice(WORDS[:3] if width == 1 else WORDS)) % 256**width
        raw[at : at + width] = value.to_bytes(width, str(rng.choice(["big", "little"])))
    elif kind == 5:
        raw[at : at + int(rng.integers(1, 64))] = rng.bytes(int(rng.integers(1, 64)))
    elif kind == 6:
        here = int(rng.integers(len(other)))
        raw[at : at + 50] = other[here : here + int(rng.integers(1, 200))]
    elif kind == 7 and (attributes := list(ATTRIBUTE.finditer(bytes(raw)))):
        _attributes(raw, attributes, rng)
    else:
        _number(raw, at, rng)


def _attributes(raw, attributes, rng):
    """Exchange the values of two attributes of XML, or give one that of the other, or name it so."""
    one, other = sorted(rng.choice(len(attributes), 2), reverse=True)
    one, other, how = attributes[one], attributes[other], rng.integers(3)
    group = 1 if how == 2 else 2
    raw[slice(*one.span(group))] = other[group]
    if how == 0:
        raw[slice(*other.span(group))] = one[group]


def _number(raw, at, rng):
    """Another number in place of the first one after a byte, of texts."""
    while at < len(raw) and not (48 <= raw[at] <= 57):
        at += 1
    end = at
    while end < len(raw) and (48 <= raw[end] <= 57 or raw[end] in b".e"):
        end += 1
    raw[at:end] = NUMBERS[int(rng.integers(len(NUMBERS)))]


def fuzz(seconds, seed, only=""):
    """Findings as (name, what, bytes), and the number of files read."""
    rng, found, count = np.random.default_rng(seed), [], 0
    with tempfile.TemporaryDirectory() as place:
        known = {name: sample for name, sample in samples(Path(place)).items() if only in name}
        whole = {name: sample.path.read_bytes() for name, sample in known.items()}
        for name, sample in known.items():
            assert verdict(sample) == "", name
        names, end = list(known), time.monotonic() + seconds
        current = Path(place) / "current"
        while time.monotonic() < end:
            child = _read_in_child(current, rng, whole, names, known, end)
            count += child[0]
            found += child[1]
            rng = np.random.default_rng(rng.integers(2**63))
    return found, count


def _read_in_child(current, rng, whole, names, known, end):
    """Reads many damaged files in a child process; a crash ends it, and the file at which it did is known."""
    log = current.with_name("log")
    log.write_text("")
    child = os.fork()
    if child == 0:
        try:
            _many(current, log, rng, whole, names, known, end)
        except BaseException:
            traceback.print_exc()
        os._exit(0)
    _, status = os.waitpid(child, 0)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    found = [(line["name"], line["what"], bytes.fromhex(line["raw"])) for line in lines if "what" in line]
    head, _, raw = current.read_bytes().partition(b"\n")
    count, name = head.decode().split(" ", 1)
    if status:
        found.append((name, f"ended with status {status}", raw))
    return int(count), found


def _many(current, log, rng, whole, names, known, end, most=4000):
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    warnings.simplefilter("ignore")
    count = 0
    with log.open("a") as file:
        while time.monotonic() < end and count < most:
            name, other = (names[int(rng.integers(len(names)))] for _ in range(2))
            raw = damaged(whole[name], rng, whole[other])
            count += 1
            current.write_bytes(f"{count} {name}\n".encode() + raw)
            known[name].path.write_bytes(raw)
            faulthandler.dump_traceback_later(SLOWEST, exit=True)
            begun = time.process_time()
            try:
                verdict(known[name])
            except Exception as error:
                where = traceback.extract_tb(error.__traceback__)[-1]
                what = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
                file.write(json.dumps({"name": name, "what": what[:400], "raw": raw.hex()}) + "\n")
                file.flush()
            if time.process_time() - begun > SLOWEST / 4:
                file.write(json.dumps({"name": name, "what": "slow", "raw": raw.hex()}) + "\n")
            faulthandler.cancel_dump_traceback_later()
            known[name].path.write_bytes(whole[name])


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of a sample's name")
    parser.add_argument("--keep", type=Path, help="folder for the bytes of findings")
    args = parser.parse_args(argv)
    found, count = fuzz(args.seconds, args.seed, args.only)
    for k, (name, what, raw) in enumerate(found):
        print(json.dumps({"name": name, "what": what, "bytes": len(raw)}), flush=True)
        if args.keep:
            args.keep.mkdir(parents=True, exist_ok=True)
            (args.keep / f"{k:03d}-{name.replace('/', '-')}").write_bytes(raw)
    print(f"{count} files read, {len(found)} findings", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
